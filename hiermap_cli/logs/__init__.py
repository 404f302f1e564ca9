"""Readers of recorded logs, their audit, and scans joined with odometry."""
