"""Drift along a corridor with doors, where only door jambs and the edges of thin walls determine the position."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from slam import Slam

DURATION = 45.0  # seconds, along the corridor only
MAX_DRIFT = 0.003  # of the distance driven, RMS over the drives
START = 10.0  # metres, from where on the drift is judged


def largest_drift(seed: int) -> float:
    """Return the largest error of a keyframe's position along the corridor, as a share of the distance driven."""
    lidar, wheels = LIDAR_MODELS["short"], WHEEL_MODELS["good"]
    slam, rows = Slam(), []
    for message in Simulation("equal_doors", seed=seed, duration=DURATION, lidar=lidar, wheels=wheels):
        slam.add(message)
        if isinstance(message, GroundTruth):
            rows.append([message.stamp, *message.pose])
    finished, truth = slam.finish(), np.array(rows)
    true = np.column_stack([np.interp(finished.keyframes.stamps, truth[:, 0], truth[:, k]) for k in (1, 2, 3)])
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(true[:, :2], axis=0).T))])
    error = (se2.compose(true[0], finished.keyframes.poses) - true)[driven > START, 0]
    assert driven[-1] > 30.0
    return float(np.max(np.abs(error) / driven[driven > START]))


@pytest.mark.slow
def test_position_along_a_corridor_with_equal_doors_does_not_drift() -> None:
    """Single drives scatter by half of the limit: odometry's random errors are not corrected between the doors."""
    drifts = [largest_drift(seed) for seed in range(6)]
    assert np.sqrt(np.mean(np.square(drifts))) < MAX_DRIFT
    assert max(drifts) < 2.0 * MAX_DRIFT
