"""Motions of the base by odometry, without its systematic errors."""

import copy
from itertools import pairwise

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry
from slam.config import OdometryConfig
from slam.geometry.segments import Floats
from slam.odometry.dead_reckoning import DeadReckoning
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.odometry.systematic_errors import SystematicErrors

from .arcs import PERIOD, ROUND, driven, history_of, twists_of

ERRORS = SystematicErrors(length=0.96, turning=1.08, veer=0.04, frame=np.array([-0.08, 0.05, 0.03]))


def model_of(errors: SystematicErrors) -> OdometryModel:
    """Return a model that has learned systematic errors."""
    model = OdometryModel(OdometryConfig())
    model._systematic = errors
    return model


def true_poses(twists: Floats, errors: SystematicErrors) -> Floats:
    """Return the poses (n + 1, 3) of the base if odometry with systematic errors has measured twists (n, 3)."""
    ahead, turned = twists[:, 0], twists[:, 2]
    turns = errors.turning * turned + errors.veer * ahead
    wheels = driven(np.column_stack([errors.length * ahead, np.zeros(len(twists)), turns]))
    return se2.compose(errors.frame, se2.compose(wheels, se2.inverse(errors.frame)))


def readings_of(poses: Floats) -> list[Odometry]:
    return [Odometry(PERIOD * k, pose) for k, pose in enumerate(poses)]


@pytest.mark.parametrize(
    "errors",
    [
        SystematicErrors(length=0.9),
        SystematicErrors(turning=1.15),
        SystematicErrors(veer=0.05),
        SystematicErrors(frame=np.array([-0.1, 0.06, 0.05])),
        ERRORS,
    ],
    ids=["length", "turning", "veer", "frame", "all"],
)
def test_a_motion_of_several_turns_is_exact_by_the_readings_on_the_path(errors: SystematicErrors) -> None:
    twists = twists_of(ROUND)
    assert twists[:, 2].sum() > 2.0 * np.pi
    measured, true, model = driven(twists), true_poses(twists, errors), model_of(errors)
    odometry, readings = DeadReckoning(model, history_of(measured)), readings_of(measured)
    for begin, end in ((0, len(twists)), (0, 103), (57, len(twists)), (57, 400), (200, 203), (9, 9)):
        motion = odometry.motion(readings[begin], readings[end])
        error = se2.between(se2.between(true[begin], true[end]), motion)
        assert np.hypot(*error[:2]) < 1e-3
        assert abs(error[2]) < 1e-3
        np.testing.assert_array_equal(odometry.motion_and_covariance(readings[begin], readings[end])[0], motion)


def test_a_chord_of_several_turns_is_wrong() -> None:
    twists = twists_of(ROUND)
    measured, true = driven(twists), true_poses(twists, ERRORS)
    first, *_, last = readings_of(measured)
    motion = DeadReckoning(model_of(ERRORS)).motion(first, last)
    assert np.hypot(*se2.between(true[-1], motion)[:2]) > 0.5


def test_the_covariance_is_that_of_the_path() -> None:
    measured = driven(twists_of(ROUND))
    model, history, readings = model_of(ERRORS), history_of(measured), readings_of(measured)
    _, covariance = DeadReckoning(model, history).motion_and_covariance(readings[3], readings[-1])
    _, of_all = model.motion_and_covariance(measured[3:])
    scale = np.sqrt(np.outer(of_all.diagonal(), of_all.diagonal()))
    np.testing.assert_allclose(covariance / scale, of_all / scale, atol=0.02)
    chord = DeadReckoning(model).motion_and_covariance(readings[3], readings[-1])[1]
    assert np.abs((chord - of_all) / scale).max() > 0.3


def test_motions_from_each_reading_to_the_next_are_those_of_each_two() -> None:
    measured = driven(twists_of(ROUND))
    odometry, readings = DeadReckoning(model_of(ERRORS), history_of(measured)), readings_of(measured)
    rows = np.array([0, 90, 91, 400, len(measured) - 1])
    stamps = PERIOD * rows
    expected = [odometry.motion_and_covariance(readings[a], readings[b]) for a, b in pairwise(rows)]
    motions, covariances = odometry.motions_and_covariances(stamps, measured[rows])
    np.testing.assert_array_equal(motions, [motion for motion, _ in expected])
    np.testing.assert_array_equal(covariances, [covariance for _, covariance in expected])
    np.testing.assert_array_equal(odometry.motions(stamps, measured[rows]), motions)
    for count in (0, 1):
        assert odometry.motions(stamps[:count], measured[rows][:count]).shape == (0, 3)
        assert [part.shape for part in odometry.motions_and_covariances(stamps[:count], measured[:count])] == [
            (0, 3),
            (0, 3, 3),
        ]


def test_a_copy_shares_the_readings_and_learns_on_its_own() -> None:
    measured = driven(twists_of(ROUND))
    odometry = DeadReckoning(OdometryModel(OdometryConfig()), OdometryHistory())
    other = copy.deepcopy(odometry)
    first, *_, last = readings_of(measured)
    for reading in readings_of(measured):
        odometry.history.add(reading)
    before = odometry.motion(first, last)
    np.testing.assert_array_equal(other.motion(first, last), before)
    for _ in range(20):
        other.model.add_motion(np.array([0.3, 0.0, 0.0]), np.array([0.27, 0.0, 0.0]), 1e6 * np.eye(3))
    np.testing.assert_array_equal(odometry.motion(first, last), before)
    assert np.hypot(*se2.between(before, other.motion(first, last))[:2]) > 0.05
