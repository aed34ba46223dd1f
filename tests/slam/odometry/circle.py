"""Odometry of a robot that drives in a circle."""

import numpy as np

from drivers import se2
from drivers.messages import Odometry
from slam.odometry.history import OdometryHistory

SPEED = 0.8  # metres per second
TURN_RATE = 1.2  # radians per second


def pose_on_circle(time: float) -> np.ndarray:
    """Return the pose [x, y, heading] at a time (seconds)."""
    turn, radius = TURN_RATE * time, SPEED / TURN_RATE
    return np.array([radius * np.sin(turn), radius * (1 - np.cos(turn)), se2.wrap(turn)])


def circle_history(count: int = 20, interval: float = 0.1) -> OdometryHistory:
    """Return `count` exact readings, `interval` seconds apart."""
    history = OdometryHistory()
    for k in range(count):
        history.add(Odometry(interval * k, pose_on_circle(interval * k)))
    return history
