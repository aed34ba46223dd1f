"""Recordings of a busy computer, which stamps several scans at once, and none for a second before."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Scan
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from slam import Finished, Slam

LENGTH = 2.0
"""Seconds in which the scans of a burst are measured."""
SQUEEZED = 0.005
"""Share of that time by which their stamps differ."""


def in_bursts(messages: Iterator[Message]) -> Iterator[Message]:
    """Yield messages with the stamps of bursts; ground truth, which is not recorded, is left out."""
    for message in messages:
        if isinstance(message, GroundTruth):
            continue
        left = LENGTH - message.stamp % LENGTH
        stamp = message.stamp + left - SQUEEZED * left
        if isinstance(message, Scan):
            message = replace(message, time_offsets=SQUEEZED * message.time_offsets)
        yield replace(message, stamp=stamp)


def finished(messages: Iterator[Message]) -> Finished:
    slam = Slam()
    for message in messages:
        slam.add(message)
    end = slam.finish()
    assert end.summary["health"]["failed"] == 0
    return end


@pytest.mark.slow
def test_stamps_in_bursts_do_not_change_the_map() -> None:
    """Odometry moves by centimetres from scan to scan of a burst, in no time: that is no slip."""
    lidar, wheels = LIDAR_MODELS["short"], WHEEL_MODELS["good"]
    drive = list(Simulation("equal_doors", seed=1, duration=20.0, lidar=lidar, wheels=wheels))
    one, other = finished(iter(drive)), finished(in_bursts(iter(drive)))
    even, bursts = one.keyframes.poses, other.keyframes.poses
    assert len(bursts) > 0.8 * len(even)
    distances = np.hypot(*(one.poses[:, None, :2] - bursts[None, :, :2]).transpose(2, 0, 1)).min(axis=0)
    assert distances.max() < 0.3  # each is on the path of the other
    length = [np.hypot(*np.diff(path[:, :2], axis=0).T).sum() for path in (even, bursts)]
    assert abs(length[1] / length[0] - 1.0) < 0.01
    assert np.abs(se2.between(even[-1], bursts[-1]))[1:].max() < 0.1
