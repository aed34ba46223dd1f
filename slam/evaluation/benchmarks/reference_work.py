"""Compute something fixed whose processor time is the unit of the times of whole runs.

A scan costs time in compiled array code and in Python between its calls, and reads more memory than a processor caches.
Another program slows down this mixture more than it slows down arithmetic on a few numbers, so the unit has to be a
mixture, too: points are looked up in a large grid, with normal equations for each look. It uses NumPy only, so a change
of this package does not change the unit.
"""

from __future__ import annotations

import time

import numpy as np

GRID_SIZE = 2000
"""Cells along a side of the grid, one byte each: more than a processor caches near its cores."""
POINTS, LOOKS = 360, 60
"""Points looked up at a time, and how many times."""


class ReferenceWork:
    """The fixed computation: `time_once` does it and returns the processor time in seconds, about 3 ms."""

    def __init__(self) -> None:
        random = np.random.default_rng(0)
        self._grid = random.integers(0, 255, (GRID_SIZE, GRID_SIZE), dtype=np.uint8)
        self._points = random.uniform(0.0, GRID_SIZE / 4, (POINTS, 2))
        self.time_once()

    def time_once(self) -> float:
        """Return the processor time of the computation in seconds."""
        start = time.process_time()
        for angle in np.linspace(0.0, 4.0, LOOKS):
            self._look_up_points(float(angle))
        return time.process_time() - start

    def _look_up_points(self, angle: float) -> None:
        """Read the grid at the points, turned by an angle (radians), and solve normal equations with the values."""
        c, s = np.cos(angle), np.sin(angle)
        turned = self._points @ np.array([[c, -s], [s, c]]) + GRID_SIZE / 2
        rows, columns = turned.astype(np.int64).T
        values = self._grid[rows, columns].astype(np.float64)
        jacobian = np.column_stack([values, turned])
        np.linalg.solve(jacobian.T @ jacobian + np.eye(3), jacobian.T @ values)
