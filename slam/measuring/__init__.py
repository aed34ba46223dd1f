"""Measurements in a map of walls: lengths, distances, angles and rooms, with the walls' joint covariance."""
