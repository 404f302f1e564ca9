"""Free space, doorways and places: which area the robot is in."""
