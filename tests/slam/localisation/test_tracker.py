"""Keeping hold of the pose when odometry fails, and the search with raw points behind it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry
from drivers.simulation.simulator import Lidar, Simulation
from slam import Finished, Slam
from slam.events import Notice
from slam.geometry.segments import Floats
from slam.matching.likelihood_field import (
    CELL,
    SEARCH_STEP,
    SEARCH_TURN_STEP,
    RecentPoints,
    ScanPoints,
    likelihood_score,
    make_field,
    search,
)

from ..listeners import EventCollector
from ..outlines import outline

ROOM = outline([(0, 0), (5, 0), (5, 2), (3.5, 2), (3.5, 4), (0, 4)])  # angular, without symmetry


def test_points_seen_where_they_are_known_are_alike() -> None:
    field = make_field(ROOM, np.zeros((0, 2)), np.array([2.0, 2.0]))
    pose = np.array([1.5, 1.5, 0.4])
    points = se2.transform(se2.inverse(pose), ROOM)
    assert likelihood_score(field, points, pose) > 0.9
    assert likelihood_score(field, points, pose + np.array([0.5, 0.0, 0.3])) < 0.4
    assert likelihood_score(field, points, pose + np.array([100.0, 0.0, 0.0])) == 0.0
    assert likelihood_score(field, np.zeros((0, 2)), pose) == 0.0


@pytest.mark.parametrize("off", [[1.0, -0.8, 0.9], [-1.3, 0.2, -1.2], [0.0, 0.0, 0.0]])
def test_a_pose_is_found_far_from_its_prediction(off: list[float]) -> None:
    field = make_field(ROOM, np.zeros((0, 2)), np.array([2.0, 2.0]))
    pose = np.array([1.5, 1.5, 0.4])
    found, like = search(field, se2.transform(se2.inverse(pose), ROOM), pose + off)
    assert like > 0.7
    assert np.abs(found - pose)[:2].max() < SEARCH_STEP
    assert abs(found[2] - pose[2]) < SEARCH_TURN_STEP


def test_the_nearest_loose_point_is_kept_for_each_cell() -> None:
    loose = np.array([[1.0, 1.0], [1.2, 1.0]])
    field = make_field(np.zeros((0, 2)), loose, np.zeros(2))
    at = np.floor((np.array([[1.01, 1.0], [1.19, 1.0], [3.0, 3.0]]) - field.origin) / CELL).astype(int)
    assert field.nearest[at[:, 0], at[:, 1]].tolist() == [0, 1, -1]


def test_old_scans_are_forgotten() -> None:
    recent = RecentPoints()
    for keyframe in range(40):
        recent.add(keyframe, ScanPoints(np.zeros((3, 2)), np.zeros((0, 2))))
    assert recent.keyframes == list(range(25, 40))


class FailingOdometry:
    """A simulation whose odometry stands still for a while, then goes on from there or makes up for what it missed."""

    def __init__(self, begin: float, end: float, *, makes_up: bool) -> None:
        self.source = Simulation(world="office", seed=1, duration=45.0, lidar=Lidar(beams=360))
        self.begin, self.end, self.makes_up = begin, end, makes_up

    def __iter__(self) -> Iterator[Message]:
        start: float | None = None
        held: Odometry | None = None
        lost: se2.Pose | None = None
        for message in self.source:
            start = message.stamp if start is None else start
            if not isinstance(message, Odometry):
                yield message
                continue
            time = message.stamp - start
            if time < self.begin:
                held = message
            elif time < self.end:
                assert held is not None
                yield Odometry(message.stamp, held.pose)
                continue
            elif not self.makes_up:
                assert held is not None
                if lost is None:
                    lost = se2.compose(held.pose, se2.inverse(message.pose))
                yield Odometry(message.stamp, se2.compose(lost, message.pose))
                continue
            yield message


def drive(source: FailingOdometry) -> tuple[Finished, Floats, list[str]]:
    """The result, the errors of the keyframes (k, 2) in metres and radians, and what was noticed."""
    listener, truth = EventCollector(), []
    slam = Slam(sinks=[listener])
    for message in source:
        slam.add(message)
        if isinstance(message, GroundTruth):
            truth.append([message.stamp, *message.pose])
    result = slam.finish()
    stamps, *columns = np.array(truth).T
    columns[2] = np.unwrap(columns[2])
    true = np.column_stack([np.interp(result.keyframe_stamps, stamps, column) for column in columns])
    error = se2.between(result.keyframes, se2.between(true[0], true))
    notices = [notice.text for notice in listener.of(Notice)]
    return result, np.column_stack([np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])]), notices


@pytest.mark.parametrize("makes_up", [True, False])
@pytest.mark.parametrize("begin", [8.0, 22.0])
def test_odometry_that_stands_still_for_two_seconds_does_no_harm(begin: float, makes_up: bool) -> None:
    _, errors, _ = drive(FailingOdometry(begin, begin + 2.0, makes_up=makes_up))
    assert errors[:, 0].max() < 0.10  # of a keyframe while it stands still
    assert errors[-10:, 0].max() < 0.03
    assert errors[-10:, 1].max() < 0.005


def test_nothing_is_noticed_where_nothing_fails() -> None:
    _, errors, noticed = drive(FailingOdometry(1e6, 2e6, makes_up=False))
    assert errors[:, 0].max() < 0.03
    assert noticed == []
