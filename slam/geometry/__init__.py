"""Geometric primitives: wall segments, corners, angles, and directions that observations do not determine."""
