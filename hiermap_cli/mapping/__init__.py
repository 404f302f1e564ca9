"""The three levels (landmark, area, environment) and the mapper that runs them over a log."""
