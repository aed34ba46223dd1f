"""Scan matching: registration with walls and corners, and the likelihood field of scan points."""
