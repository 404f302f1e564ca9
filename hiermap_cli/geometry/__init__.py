"""SE(2), lines and points, with their Jacobians."""
