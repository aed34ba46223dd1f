"""Compute something fixed whose processor time is the unit of the times of whole runs.

A scan costs time in compiled array code, in GTSAM and in Python between the two, and reads more memory than a processor
caches. Another program slows down this mixture more than it slows down arithmetic on a few numbers, so the unit has
to be a mixture, too: points are looked up in a large grid, with normal equations for each look, and a small factor
graph is solved incrementally. It uses numpy and GTSAM only, so a change of this package does not change the unit.
"""

from __future__ import annotations

import time

import gtsam
import numpy as np

GRID_SIZE = 2000
"""Cells along a side of the grid, one byte each: more than a processor caches near its cores."""
POINTS, LOOKS = 360, 40
"""Points looked up at a time, and how many times."""
POSES, LOOP_LENGTH = 12, 4
"""Poses of the graph, and steps between the two poses of its loops."""


class ReferenceWork:
    """The fixed computation: `time_once` does it and returns the processor time in seconds, about 3 ms."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self._grid = rng.integers(0, 255, (GRID_SIZE, GRID_SIZE), dtype=np.uint8)
        self._points = rng.uniform(0.0, GRID_SIZE / 4, (POINTS, 2))
        self._noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.1, 0.05]))
        self.time_once()

    def time_once(self) -> float:
        """Return the processor time of the computation in seconds."""
        start = time.process_time()
        self._look_up_points()
        self._solve_graph()
        return time.process_time() - start

    def _look_up_points(self) -> None:
        """Read the grid at the points, turned by one angle after the other, and solve normal equations for each."""
        for angle in np.linspace(0.0, 4.0, LOOKS):
            c, s = np.cos(angle), np.sin(angle)
            turned = self._points @ np.array([[c, -s], [s, c]]) + GRID_SIZE / 2
            rows, columns = turned.astype(np.int64).T
            values = self._grid[rows, columns].astype(np.float64)
            jacobian = np.column_stack([values, turned])
            np.linalg.solve(jacobian.T @ jacobian + np.eye(3), jacobian.T @ values)

    def _solve_graph(self) -> None:
        """Add poses to a graph one by one, with odometry and a loop each, and solve it after each."""
        solver = gtsam.ISAM2()
        for key in range(POSES):
            factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            values.insert(key, gtsam.Pose2(0.5 * key + 0.01, 0.02, 0.01))
            if key == 0:
                factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), self._noise))
            for steps in (1, LOOP_LENGTH):
                if key >= steps:
                    step = gtsam.Pose2(0.5 * steps, 0.0, 0.0)
                    factors.add(gtsam.BetweenFactorPose2(key - steps, key, step, self._noise))
            solver.update(factors, values)
            solver.calculateEstimatePose2(key)
