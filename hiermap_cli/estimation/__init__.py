"""The stochastic map V, C(V): predict, add, constrain; association; noise models."""
