"""Formats of others: HouseExpo, ROS maps and cameras, DOPE, BOP."""
