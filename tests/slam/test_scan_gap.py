"""Nothing is seen while the robot turns by more than half a turn, by odometry with a wrong distance of the wheels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan
from slam import Slam
from slam.events import EventRecorder, SuspectFound
from slam.graph.factors import FactorKind

DURATION = 75.0  # seconds
GAPS = (25.5, 36.0), (59.5, 69.5)  # in which it turns by 179 degrees: on its first lap, and on its second one
TURNING = 1.09  # factor by which odometry measures turns too large


def drive(begin: float, end: float, *, covered: bool) -> Iterator[Message]:
    """Yield the messages of a drive around a room that looks the same after half a turn.

    From `begin` to `end` scans are missing, or the lidar is `covered`.
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
    [(GAPS[0], False, False), (GAPS[0], False, True), (GAPS[1], False, False), (GAPS[1], True, False)],
)
def test_the_robot_turns_by_more_than_half_a_turn(gap: tuple[float, float], *, covered: bool, refine: bool) -> None:
    listener, truth = EventRecorder(), []
    slam = Slam(sinks=[listener], refine=refine)
    for message in drive(*gap, covered=covered):
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
        slam.add(message)
    result, true = slam.finish(), np.array(truth)
    assert not listener.of(SuspectFound)
    seen = (result.stamps < gap[0] - 0.2) | (result.stamps > gap[1] + 0.2)
    expected = np.column_stack([np.interp(result.stamps, true[:, 0], true[:, k]) for k in (1, 2)])
    start = result.keyframe_stamps[0]
    frame = [np.interp(start, true[:, 0], column) for column in true[:, 1:].T]
    error = se2.transform(frame, result.poses[:, :2]) - expected
    assert np.hypot(*error[seen].T).max() < 0.05
    assert max(turn_errors(slam)) < 4.0


def turn_errors(slam: Slam) -> Iterator[float]:
    """Yield by how many standard deviations the turn by odometry to each keyframe differs from the estimate."""
    graph = slam.slam_state.mapper.graph
    poses = graph.keyframe_poses(slam.slam_state.mapper.keyframe_count)
    for factor in graph.solver.factors.values():
        if factor.kind is FactorKind.ODOMETRY:
            turn = se2.between(poses[factor.first], poses[factor.second])[2]
            yield abs(se2.wrap(turn - factor.measured[2])) / np.sqrt(factor.covariance[2, 2])
