"""Simulate a robot with a lidar and wheels in a building."""
