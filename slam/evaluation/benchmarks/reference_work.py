"""Compute something fixed whose processor time is the unit of the times of whole runs.

A scan costs time in compiled array code, which reads more memory than a processor caches, and in Python between its
calls. Processors differ in both, and programs that run beside it slow down the one more than the other: on one machine
look-ups in memory took twice as long at one hour as at another, and runs one and a half times as long. So the unit has
to be a mixture, too: half of its time points are looked up in a large grid, with normal equations for each look, and
half of it small objects and arrays are handled. It uses Python and NumPy only, so a change of this package does not
change the unit.
"""

from __future__ import annotations

import time

import numpy as np

GRID_SIZE = 2000
"""Cells along a side of the grid, one byte each: more than a processor caches near its cores."""
POINTS, LOOKS = 360, 30
"""Points looked up at a time, and how many times."""
OBJECTS = 350
"""Objects handled, in about the time of all looks."""


class ReferenceWork:
    """The fixed computation: `time_once` does it and returns the processor time in seconds, 1 to 3 ms."""

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
        self._handle_objects()
        return time.process_time() - start

    def _look_up_points(self, angle: float) -> None:
        """Read the grid at the points, turned by an angle (radians), and solve normal equations with the values."""
        c, s = np.cos(angle), np.sin(angle)
        turned = self._points @ np.array([[c, -s], [s, c]]) + GRID_SIZE / 2
        rows, columns = turned.astype(np.int64).T
        values = self._grid[rows, columns].astype(np.float64)
        jacobian = np.column_stack([values, turned])
        np.linalg.solve(jacobian.T @ jacobian + np.eye(3), jacobian.T @ values)

    def _handle_objects(self) -> None:
        """Store objects with small arrays under their names, and compute with those stored before."""
        table = {str(k): (0.5 * k, np.array([k, 1.0, 0.5])) for k in range(2)}
        for k in range(OBJECTS):
            place, pose = table[str(k % len(table))]
            moved = pose + np.array([place, 0.0, 1.0])
            table[str(k)] = float(moved @ pose) % 10.0, moved % 1.0
