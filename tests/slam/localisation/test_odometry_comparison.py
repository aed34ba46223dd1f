"""Odometry fails for long if it contradicts the scans in each motion, until it agrees with them again."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry
from slam.config import OdometryConfig
from slam.geometry.segments import Floats
from slam.localisation.odometry_comparison import ComparedFix, OdometryComparison
from slam.localisation.pose_predictor import PosePredictor
from slam.localisation.small_objects import SmallObjects
from slam.localisation.tracking import PoseFix
from slam.matching.point_matcher import Prediction
from slam.odometry.dead_reckoning import DeadReckoning
from slam.odometry.error_model import OdometryModel
from slam.odometry.velocity import STEADY_SECONDS, VelocityFilter

from ..tracking_results import tracking_result

STEP = np.array([0.05, 0.0, 0.0])  # motion between two scans
PERIOD = 0.1  # seconds
SIGMAS = np.array([0.003, 0.003, 0.002])
CORRIDOR = np.array([1.0, 0.003, 0.002])  # errors of a scan that does not determine the position along the walls


def certain(_prediction: Prediction) -> bool:
    return True


def compare(_prediction: Prediction, _pose: se2.Pose) -> tuple[None, float]:
    return None, 0.0


def failing(
    motions: Iterable[tuple[Floats, Floats]],
    period: float = PERIOD,
    sigmas: Floats = SIGMAS,
    *,
    is_certain: bool = True,
    speed: float | None = None,
) -> list[bool]:
    """Return whether odometry fails after each motion by the scans and by odometry, [x, y, heading].

    sigmas      (3,) standard deviations of the poses by the scans
    is_certain  whether contradictions between the scans and odometry are certain
    speed       metres per second ahead, as it is estimated before each motion; None if it is not known
    """
    velocity = VelocityFilter()
    if speed is not None:
        velocity = VelocityFilter(np.array([speed, 0.0, 0.0]), np.full(3, 1e-4))
    comparison, random = OdometryComparison(), np.random.default_rng(3)
    reckoning = DeadReckoning(OdometryModel(OdometryConfig()))
    pose, odometry, found = np.zeros(3), np.zeros(3), list[bool]()
    for by_scans, by_odometry in motions:
        pose, odometry = se2.compose(pose, by_scans), se2.compose(odometry, by_odometry)
        reading = Odometry(period * len(found), odometry)
        fix = PoseFix(se2.compose(pose, SIGMAS * random.standard_normal(3)), reading)
        compared = ComparedFix(fix, np.diag(sigmas**-2), velocity, period)
        comparison.add(compared, reckoning, np.diag(SIGMAS**2), lambda _prediction: is_certain)
        found.append(comparison.failing)
    return found


def test_odometry_fails_after_the_time_in_which_a_robot_changes_its_velocity() -> None:
    found = failing([(STEP, STEP)] * 20 + [(STEP, 0 * STEP)] * 20 + [(STEP, STEP)] * 10)
    begin, end = found.index(True), len(found) - found[::-1].index(True)
    assert STEADY_SECONDS <= (begin - 19) * PERIOD < STEADY_SECONDS + 0.4
    assert 40 <= end < 44
    assert all(found[begin:end])


def test_people_who_walk_with_the_robot_do_not_make_odometry_fail() -> None:
    assert not any(failing([(0.0 * STEP, STEP)] * 100, is_certain=False))


def test_a_motion_that_no_robot_makes_does_not_make_odometry_fail() -> None:
    backwards = [(-10.0 * STEP, STEP)] * 60
    assert not any(failing(backwards, speed=0.5))
    assert failing(backwards, speed=-5.0)[-1]


def test_scans_that_do_not_determine_the_motion_neither_contradict_nor_agree() -> None:
    assert not any(failing([(0.0 * STEP, STEP)] * 100, sigmas=CORRIDOR))


def test_odometry_is_used_again_where_nothing_else_determines_the_motion() -> None:
    comparison, found = OdometryComparison(STEADY_SECONDS), list[bool]()
    reckoning = DeadReckoning(OdometryModel(OdometryConfig()))
    for k in range(20):
        fix, velocity = PoseFix(k * STEP, Odometry(k * PERIOD, k * STEP)), VelocityFilter()
        compared = ComparedFix(fix, np.diag(CORRIDOR**-2), velocity, PERIOD)
        comparison.add(compared, reckoning, np.diag(SIGMAS**2), certain)
        found.append(comparison.failing)
    assert STEADY_SECONDS <= found.index(False) * PERIOD < STEADY_SECONDS + 0.4


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_worn_wheels_do_not_fail(scale: float) -> None:
    assert not any(failing([(STEP, scale * STEP)] * 100))


def test_a_slip_a_jump_and_a_late_reading_do_not_last() -> None:
    slip = [(0.0 * STEP, 8.0 * STEP)]
    jump = [(STEP, np.array([0.0, 1.5, 0.3]))]
    late = [(STEP, 0.0 * STEP)] * 3 + [(STEP, 4.0 * STEP)]
    stand = [(0.0 * STEP, 0.0 * STEP)] * 50
    assert not any(failing([(STEP, STEP)] * 9 + [*stand, *slip, *stand] + [(STEP, STEP)] * 9 + [*jump, *stand, *late]))


def test_a_robot_that_stands_does_not_show_that_odometry_works_again() -> None:
    found = failing([(STEP, 0.0 * STEP)] * 30 + [(0.0 * STEP, 0.0 * STEP)] * 100 + [(STEP, 0.0 * STEP)] * 10)
    assert all(found[20:])


def test_a_correction_of_the_map_is_no_motion() -> None:
    comparison, reckoning = OdometryComparison(), DeadReckoning(OdometryModel(OdometryConfig()))
    pose, fix = np.zeros(3), PoseFix(np.zeros(3), Odometry(-PERIOD, np.zeros(3)))
    for k in range(60):
        pose = se2.compose(fix.pose, STEP)
        fix = PoseFix(pose, Odometry(k * PERIOD, k * STEP))
        compared = ComparedFix(fix, np.diag(SIGMAS**-2), VelocityFilter(), PERIOD)
        comparison.add(compared, reckoning, np.diag(SIGMAS**2), certain)
        if k % 3 == 0:  # a loop is closed
            correction = np.array([0.8, -0.5, 0.2])
            comparison.follow(correction, fix)
            fix = PoseFix(se2.compose(pose, correction), fix.odometry)
        assert not comparison.contradicted_for


def test_the_motion_is_predicted_to_be_even_while_odometry_fails() -> None:
    predictor = PosePredictor(DeadReckoning(OdometryModel(OdometryConfig())))
    pose, odometry = np.zeros(3), np.zeros(3)
    predictor.move_to(pose, Odometry(0.0, odometry))
    for k in range(40):
        reading = Odometry(k * PERIOD, odometry)
        predictions = predictor.predict(reading)
        if k > 30:
            np.testing.assert_allclose(predictions.usual.pose, pose, atol=0.005)
        slipped = k >= 20
        result = tracking_result(pose=pose, information=1e6 * np.eye(3), slipped=slipped)
        predictor.update(result, reading, None, certain, compare)
        pose = pose + STEP
        odometry = odometry if k >= 19 else odometry + STEP
    assert predictor.odometry_failing
    assert not predictor.measured
    state = predictor.state(SmallObjects(), 0.0)
    assert state is not None
    restored = PosePredictor(DeadReckoning(OdometryModel(OdometryConfig())))
    restored.restore(state)
    assert restored.odometry_failing
