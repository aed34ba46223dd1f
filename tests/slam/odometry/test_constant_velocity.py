"""Motions predicted at constant velocity, and their errors."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Scan
from slam.config import OdometryConfig
from slam.odometry.constant_velocity import ConstantVelocity
from slam.odometry.predicted_motion import PredictedMotionModel

TWIST = np.array([0.5, 0.0, 0.8])
"""Metres and radians per second."""
ACCURATE, UNKNOWN = 1e-6 * np.eye(3), 1e6 * np.eye(3)


def scan(stamp: float, duration: float = 0.0) -> Scan:
    count = 10
    return Scan(stamp, np.ones(count), np.linspace(-1, 1, count), np.linspace(0.0, duration, count), 0.0, 10.0)


def arc(seconds: float) -> se2.Pose:
    """Return the pose after driving with TWIST."""
    turn, radius = TWIST[2] * seconds, TWIST[0] / TWIST[2]
    return np.array([radius * np.sin(turn), radius * (1.0 - np.cos(turn)), turn])


def test_an_arc_is_continued_also_within_a_sweep() -> None:
    predictor = ConstantVelocity()
    for k in range(10):
        list(predictor.readings(scan(0.1 * k, 0.08)))
        predictor.correct(arc(0.1) if k else None, ACCURATE)
    before = predictor._pose
    begin, middle, end = predictor.readings(scan(1.0, 0.08))
    np.testing.assert_allclose(se2.between(before, middle.pose), arc(0.1), atol=1e-3)
    np.testing.assert_allclose(se2.between(begin.pose, end.pose), arc(0.08), atol=1e-3)
    assert (begin.stamp, middle.stamp, end.stamp) == pytest.approx((1.0, 1.04, 1.08))


def test_the_velocity_stays_where_scans_do_not_determine_it() -> None:
    predictor = ConstantVelocity()
    for k in range(10):
        list(predictor.readings(scan(0.1 * k)))
        predictor.correct(arc(0.1) if k else None, ACCURATE)
    for k in range(10, 15):
        list(predictor.readings(scan(0.1 * k)))
        predictor.correct(np.zeros(3), UNKNOWN)
    np.testing.assert_allclose(predictor.velocity, TWIST, atol=0.02)


def test_scans_whose_stamps_come_in_bursts_do_not_make_the_robot_fast() -> None:
    predictor, stamps = ConstantVelocity(), 0.1 * np.arange(40)
    stamps[25:28] = stamps[27] + np.array([0.0, 1e-3, 2e-3])
    for k, stamp in enumerate(stamps):
        list(predictor.readings(scan(stamp)))
        predictor.correct(arc(0.1) if k else None, ACCURATE)
        assert np.hypot(*predictor.velocity[:2]) < 1.1 * TWIST[0]


def test_errors_are_learned_and_drift_counts_where_scans_show_nothing() -> None:
    random = np.random.default_rng(1)
    model = PredictedMotionModel(OdometryConfig())
    for _ in range(200):
        motion = np.array([0.3, 0.0, 0.1])
        error = np.array([0.04, 0.04, 0.05]) * random.standard_normal(3)
        model.add_motion(motion, se2.compose(motion, error), 1e6 * np.eye(3))
    np.testing.assert_allclose(model.floors, [0.04, 0.05], rtol=0.3)
    determined = np.diag([1e5, 1e5, 1e6])
    assert not model.correlated_drift(motion, determined).any()
    corridor = np.diag([1e2, 1e5, 1e6])  # nothing along x
    drift = model.correlated_drift(motion, corridor)
    assert drift[0, 0] > 0.3**2
    assert drift[1, 1] == pytest.approx(0.0, abs=1e-9)
