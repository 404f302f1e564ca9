"""Odometry that lies: which way it drives, stands, steps, is carried."""
