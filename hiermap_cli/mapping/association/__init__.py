"""Sightings matched with the area's walls and ends, and the robot found again among them."""
