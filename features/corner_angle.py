"""Smallest angle between two walls that form a corner."""

from __future__ import annotations

# Sine of this angle; the variance of a corner grows as 1/sin^2. Origin: chosen, 11.5 degrees; not measured.
MIN_SINE = 0.2
