"""Estimate the lidar's mount and range bias from a recording."""
