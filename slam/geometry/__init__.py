"""Provide geometric primitives: wall segments, angles, and the directions a place leaves unobserved."""
