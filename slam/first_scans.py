"""Loading of what the first scans call, so that none of them is delayed by it, and the drive that calls it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drivers import se2
from drivers.messages import Floats, Odometry, Scan

from .config import Config
from .estimation.estimator import Estimator
from .estimation.slam_state import SlamState
from .preprocessing.preprocessor import Preprocessor

ROOM = 4.0, 3.0
"""Length and width of the simulated room, metres."""
BEAMS = 180
WARMUP_SCANS = 20
STEP = 0.1
"""Distance between scans, metres."""
INTERVAL = 0.1
"""Time between scans, seconds."""
TURN = 0.08
"""Turn between scans, radians."""


def load_for_first_scans() -> None:
    """Load, or compile, what makes features of scans and estimates path and map from them while driving."""
    preprocessor, estimator = Preprocessor(Config()), Estimator(SlamState(Config()))
    for message in first_drive():
        preprocessor.add(message)
        while (scan := preprocessor.next_scan()) is not None:
            estimator.process(preprocessor.process(scan, estimator.state.odometry_model))


def first_drive() -> Iterator[Odometry | Scan]:
    """Yield the messages of a robot that drives a curve through a small room with an object in it."""
    # no beam is parallel to a wall, where a distance would be infinite
    angles = 2 * np.pi * ((np.arange(BEAMS) + 0.5) / BEAMS - 0.5)
    offsets = np.linspace(0.0, 0.5 * INTERVAL, BEAMS)
    random = np.random.default_rng(0)
    for k in range(WARMUP_SCANS):
        turned, radius = TURN * k, STEP / TURN
        pose = np.array([-1.0 + radius * np.sin(turned), 0.7 - radius * (1.0 - np.cos(turned)), -turned])
        yield Odometry(INTERVAL * k, pose)
        yield Scan(INTERVAL * k, _ranges(pose, angles) + random.normal(0.0, 0.01, BEAMS), angles, offsets, 0.1, 30.0)
    yield Odometry(INTERVAL * WARMUP_SCANS, pose)


def _ranges(pose: se2.Pose, angles: Floats) -> Floats:
    """Return the ranges (n,) to the walls of a room around the map's origin, with some shorter returns between them."""
    c, s = np.cos(angles + pose[2]), np.sin(angles + pose[2])
    to_sides = (np.sign(c) * ROOM[0] / 2 - pose[0]) / c
    to_ends = (np.sign(s) * ROOM[1] / 2 - pose[1]) / s
    ranges = np.minimum(to_sides, to_ends)
    ranges[::9] *= 0.7
    return np.asarray(ranges, dtype=np.float64)
