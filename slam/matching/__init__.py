"""Scan matching: registration with walls and corners, and matching of scan points to a distance field."""
