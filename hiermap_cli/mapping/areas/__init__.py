"""Rooms and corridors as people see them, made of the filter's areas."""
