"""Odometry, scan matching and mapping: a robot's own map."""
