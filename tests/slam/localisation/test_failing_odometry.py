"""Odometry that fails for long is replaced by predictions from the scans, until it agrees with them again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.evaluation.benchmarks.scenarios.buildings import random_building
from slam.events import EventRecorder, Notice
from slam.geometry.segments import Floats

Failure = Literal["stands still", "ends", "pauses"]
BEGIN, END, DURATION = 8.0, 20.0, 26.0  # seconds of the failure and of the drive


def drive(failure: Failure) -> Iterator[Message]:
    """Yield the messages of a drive in a building with corridors whose odometry fails from BEGIN on."""
    held = np.zeros(3)
    for message in Simulation(random_building(401), 401, DURATION, LidarModel(360, 8.0)):
        if isinstance(message, Odometry):
            if message.stamp < BEGIN:
                held = message.pose
            elif failure == "stands still":
                message = replace(message, pose=held)
            elif failure == "ends" or message.stamp < END:
                continue
        yield message


@pytest.mark.parametrize(
    "failure",
    ["stands still", pytest.param("ends", marks=pytest.mark.slow), pytest.param("pauses", marks=pytest.mark.slow)],
)
def test_the_path_does_not_need_odometry_that_fails(failure: Failure) -> None:
    listener, truth = EventRecorder(), []
    slam = Slam(sinks=[listener])
    for message in drive(failure):
        slam.add(message)
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
    result, last_scan = slam.finish(), slam.slam_state.trajectory.relative_poses()[0][-1]
    seen = result.stamps <= last_scan
    assert position_errors(result.stamps[seen], result.poses[seen], np.array(truth)).max() < 0.1
    (text,) = (notice.text for notice in listener.of(Notice) if "was missing or contradicted" in notice.text)
    seconds = float(text.split(" for ")[1].split(" s")[0])
    assert seconds == pytest.approx((END if failure == "pauses" else DURATION) - BEGIN, abs=2.0)


def position_errors(stamps: Floats, poses: Floats, truth: Floats) -> Floats:
    """Return the distances (n,) of poses (n, 3) from the truth (m, 4), stamp and pose, aligned at its beginning."""
    known = (stamps >= truth[0, 0]) & (stamps <= truth[-1, 0])
    true = np.column_stack([np.interp(stamps[known], truth[:, 0], truth[:, k]) for k in (1, 2)])
    aligned = se2.transform(se2.inverse(truth[0, 1:]), true)
    return np.asarray(np.hypot(*(poses[known, :2] - aligned).T))
