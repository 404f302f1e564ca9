"""How wrong a run is: trajectory, relations, map and consistency metrics."""
