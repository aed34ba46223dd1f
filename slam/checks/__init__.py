"""Checks of a finished run against itself: where scans, odometry and path contradict each other."""

from __future__ import annotations

from .suspect import Suspect

__all__ = ["Suspect"]
