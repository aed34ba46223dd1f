"""Odometry that stands still for seconds is noticed though no single scan contradicts it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Message, Odometry
from drivers.simulation import LidarModel, Simulation, World, WorldFile, build_world
from slam import Slam
from slam.localisation.followed_motion import FollowedMotion
from slam.localisation.match_target import MIN_EVIDENCE
from slam.matching.offset_tiles import FIELD_CELL
from slam.matching.point_matcher import PointMatch, Prediction
from slam.odometry.velocity import VelocityFilter

SPEED = 0.4  # metres per second
STANDS, LASTS = 35.0, 4.0  # seconds: odometry stands still
LENGTH, WIDTH, DEPTH = 30.0, 2.0, 3.0  # metres, of the corridor and of its rooms
DOORS = [(4.0, 1.0), (9.5, 1.0), (15.0, 1.2), (19.0, 1.0), (25.0, 1.0)]
PERIOD = 0.125  # seconds between two scans
AHEAD = VelocityFilter(np.array([SPEED, 0.0, 0.0]), np.full(3, 0.05**2))


def corridor() -> World:
    """Return a corridor with rooms on one side."""
    sides = [((0, WIDTH), (LENGTH, WIDTH)), ((0, 0), (0, WIDTH)), ((LENGTH, 0), (LENGTH, WIDTH))]
    sides += [((0, -DEPTH), (LENGTH, -DEPTH)), *(((x, -DEPTH), (x, 0)) for x in (7.0, 13.0, 22.0))]
    walls = [{"from": start, "to": end, "thickness": 0.12} for start, end in sides]
    walls.append({"from": (0, 0), "to": (LENGTH, 0), "thickness": 0.12, "doors": DOORS})
    path = [(1.0, 1.0), (LENGTH - 2.0, 1.0)]
    return build_world("corridor", WorldFile.model_validate({"speed": SPEED, "path": path, "walls": walls}))


def standing(simulation: Simulation) -> Iterator[Message]:
    """Yield the messages of a drive, with odometry that stands still for LASTS seconds and goes on from there."""
    held = lost = np.zeros(3)
    for message in simulation:
        if isinstance(message, Odometry):
            if message.stamp < STANDS:
                held = lost = message.pose
            elif message.stamp < STANDS + LASTS:
                lost = message.pose
            yield Odometry(message.stamp, se2.compose(held, se2.between(lost, message.pose)))
        else:
            yield message


def missing_way(seed: int) -> float:
    """Return the error of the last position of a drive in which odometry stands still, metres."""
    lidar = LidarModel(beams=360, rate=1.0 / PERIOD, range_max=8.0, field_of_view=np.radians(240.0))
    simulation = Simulation(corridor(), seed, STANDS + LASTS + 3.0, lidar)
    slam = Slam()
    for message in standing(simulation):
        slam.add(message)
    finished = slam.finish()
    first, last = simulation.trajectory.poses_at(finished.stamps[[0, -1]])
    driven, mapped = se2.between(first, last), se2.between(finished.poses[0], finished.poses[-1])
    return float(np.hypot(*(mapped - driven)[:2]))


@pytest.mark.slow
def test_a_slow_robot_is_followed_while_odometry_stands_still() -> None:
    """Otherwise the whole way is missing that odometry has not measured."""
    assert np.mean([missing_way(seed) for seed in range(4)]) < 0.5 * SPEED * LASTS


def scans(
    seconds: float, evidence: float, odometry: float = 0.0, matched: float | None = None
) -> tuple[FollowedMotion | None, int]:
    """Return the hypothesis of an even motion after some seconds of scans, and how many of them were compared.

    evidence  (nats) of each compared scan
    odometry  metres per second by odometry, along x
    matched   the same by the match of each scan; None if the match leads to the pose by odometry
    """
    hypothesis: FollowedMotion | None = FollowedMotion.begin(np.zeros(3), AHEAD)
    compared = 0
    for k in range(1, round(seconds / PERIOD) + 1):

        def compare(prediction: Prediction, _: se2.Pose, time: float = k * PERIOD) -> tuple[PointMatch | None, float]:
            nonlocal compared
            compared += 1
            if matched is None:
                return None, evidence
            pose = np.array([matched * time, 0.0, 0.0])
            return PointMatch(pose, 1e4 * np.eye(3), prediction, 0.0, 1.0, 100), evidence

        assert hypothesis is not None
        hypothesis = hypothesis.after(PERIOD).compared(np.array([odometry * k * PERIOD, 0.0, 0.0]), compare)
        if hypothesis is None:
            break
    return hypothesis, compared


def test_weak_evidence_of_scans_in_a_row_adds_up() -> None:
    hypothesis, compared = scans(1.5, 0.2 * MIN_EVIDENCE, matched=SPEED)
    assert hypothesis is not None
    assert hypothesis.evidence >= MIN_EVIDENCE
    np.testing.assert_allclose(hypothesis.prediction().pose, [1.5 * SPEED, 0.0, 0.0], atol=FIELD_CELL)
    assert compared <= 1.5 * SPEED / FIELD_CELL


def test_scans_that_fit_by_odometry_refute_the_even_motion() -> None:
    assert scans(1.5, -0.5 * MIN_EVIDENCE)[0] is None


def test_scans_that_fit_everywhere_decide_nothing() -> None:
    hypothesis = scans(1.0, 0.0)[0]
    assert hypothesis is not None
    assert hypothesis.evidence == 0.0


def test_the_even_motion_is_given_up_where_the_robot_may_be_anywhere() -> None:
    assert scans(30.0, 0.0)[0] is None


@pytest.mark.parametrize("share", [0.7, 1.4])
def test_an_error_of_calibration_is_no_slip(share: float) -> None:
    assert scans(2.0, MIN_EVIDENCE, odometry=share * SPEED, matched=SPEED)[0] is None


def test_the_hypothesis_moves_with_a_corrected_map() -> None:
    before, after = np.array([1.0, 2.0, 0.5]), np.array([3.0, 1.0, 2.0])
    hypothesis = FollowedMotion.begin(before, AHEAD).after(PERIOD)
    expected = se2.compose(after, se2.between(before, hypothesis.prediction().pose))
    np.testing.assert_allclose(hypothesis.moved(before, after).prediction().pose, expected, atol=1e-12)
