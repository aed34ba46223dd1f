"""Nothing is seen while the robot drives on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import WHEEL_MODELS, Simulation
from slam import Slam
from slam.evaluation.benchmarks.scenarios.buildings import random_building
from slam.events import EventRecorder, Finished, SuspectFound
from slam.geometry.segments import Floats
from slam.graph.factors import FactorKind

from .checks.drives import LIDAR

DURATION = 75.0  # seconds
GAPS = (25.5, 36.0), (59.5, 69.5)  # in which it turns by 179 degrees: on its first lap, and on its second one
TURNING = 1.09  # factor by which odometry measures turns too large


def drive(begin: float, end: float, *, covered: bool) -> Iterator[Message]:
    """Yield the messages of a drive around a room that looks the same after half a turn.

    Odometry measures its turns wrong. From `begin` to `end` scans are missing, or the lidar is `covered`.
    """
    before, pose = np.zeros(3), np.zeros(3)
    for message in drivers.open(f"sim:room?duration={DURATION:.0f}"):
        if isinstance(message, Odometry):
            motion, before = se2.between(before, message.pose), message.pose
            pose = se2.compose(pose, motion * [1.0, 1.0, TURNING])
            yield replace(message, pose=pose)
        elif not (isinstance(message, Scan) and begin < message.stamp < end):
            yield message
        elif covered:
            yield replace(message, ranges=np.full(len(message.ranges), np.nan))


@pytest.mark.parametrize(
    ("gap", "covered", "refine"),
    [
        (GAPS[1], False, False),
        pytest.param(GAPS[0], False, False, marks=pytest.mark.slow),
        pytest.param(GAPS[0], False, True, marks=pytest.mark.slow),
        pytest.param(GAPS[1], True, False, marks=pytest.mark.slow),
    ],
)
def test_the_robot_turns_by_more_than_half_a_turn(gap: tuple[float, float], *, covered: bool, refine: bool) -> None:
    listener = EventRecorder()
    slam = Slam(sinks=[listener], refine=refine)
    result, errors = mapped(drive(*gap, covered=covered), slam)
    assert not listener.of(SuspectFound)
    seen = (result.stamps < gap[0] - 0.2) | (result.stamps > gap[1] + 0.2)
    assert errors[seen].max() < 0.05
    assert max(turn_errors(slam)) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("building", [442, 460])
def test_the_robot_drives_to_a_corridor_that_looks_like_the_last_one(building: int) -> None:
    """Where odometry leads nothing was mapped, and the first scan fits best in the old corridor, 16 m away."""
    drive = Simulation(random_building(building), building, 70.0, LIDAR, WHEEL_MODELS["good"])
    result, errors = mapped(drive, Slam(), gap=(40.0, 60.0))
    after = result.stamps > 60.0
    assert errors[after].max() < 1.0


def mapped(drive: Iterable[Message], slam: Slam, gap: tuple[float, float] = (0.0, 0.0)) -> tuple[Finished, Floats]:
    """Map a drive without the scans in a gap, and return the result with the error of the path at each scan, metres."""
    truth = []
    for message in drive:
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
        if not (isinstance(message, Scan) and gap[0] <= message.stamp < gap[1]):
            slam.add(message)
    result, true = slam.finish(), np.array(truth)
    expected = np.column_stack([np.interp(result.stamps, true[:, 0], true[:, k]) for k in (1, 2)])
    start = result.keyframes.stamps[0]
    frame = [np.interp(start, true[:, 0], column) for column in true[:, 1:].T]
    return result, np.hypot(*(se2.transform(frame, result.poses[:, :2]) - expected).T)


def turn_errors(slam: Slam) -> Iterator[float]:
    """Yield by how many standard deviations the turn by odometry to each keyframe differs from the estimate."""
    graph = slam.slam_state.mapper.graph
    poses = graph.keyframe_poses(slam.slam_state.mapper.keyframe_count)
    for factor in graph.solver.factors.values():
        if factor.kind is FactorKind.ODOMETRY:
            turn = se2.between(poses[factor.first], poses[factor.second])[2]
            yield abs(se2.wrap(turn - factor.measured[2])) / np.sqrt(factor.covariance[2, 2])
