"""From scans to segments to landmark observations; nothing here knows the map."""
