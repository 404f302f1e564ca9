"""Refinement: the whole log again, as one sparse least-squares problem."""
