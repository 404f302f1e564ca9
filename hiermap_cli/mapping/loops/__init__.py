"""Loops found off line, by fragments of the log held against each other."""
