"""Odometry of a robot that drives along arcs, ahead and back, and turns in place."""

import numpy as np

from drivers import se2
from slam.geometry.segments import Floats
from slam.odometry.history import OdometryHistory

STEP, STEP_TURN, PERIOD = 0.01, 0.02, 0.02  # metres or radians between two readings, and seconds
LEFT_AND_RIGHT = [(1.0, 0.0), (1.2, 1.9), (0.8, -0.7), (0.0, 1.5), (1.4, -1.8), (-1.6, 0.4), (1.0, 1.2)]
ROUND = [(0.8, 0.0), (2.4, 4.0), (0.0, 2.5), (1.5, 3.0), (-1.0, 0.4), (1.8, -2.5), (1.2, 3.2), (0.7, 0.0)]
"""Lengths (metres, negative ones are driven back) and turns (radians) of arcs."""


def twists_of(arcs: list[tuple[float, float]]) -> Floats:
    """Return the twists (n, 3) between readings along arcs, metres, metres and radians."""
    twists = []
    for length, turn in arcs:
        count = int(np.ceil(max(abs(length) / STEP, abs(turn) / STEP_TURN)))
        twists += [np.array([length, 0.0, turn]) / count] * count
    return np.array(twists)


def driven(twists: Floats) -> Floats:
    """Return the poses (n + 1, 3) before and after each twist (n, 3), the first one at the origin."""
    poses = [np.zeros(3)]
    for motion in se2.exp(twists):
        poses.append(se2.compose(poses[-1], motion))
    return np.array(poses)


def history_of(poses: Floats) -> OdometryHistory:
    """Return readings of poses (n, 3), PERIOD apart."""
    return OdometryHistory.from_arrays(PERIOD * np.arange(len(poses)), poses)
