"""Predictions of the pose after a tentative scan, and the cost of a slip."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry
from slam.config import OdometryConfig
from slam.localisation.pose_predictor import PosePredictor
from slam.localisation.predictions import Alternative, TentativePose
from slam.localisation.small_objects import SmallObjects
from slam.localisation.tracking import PoseFix, TrackingStatus
from slam.matching.point_matcher import Prediction
from slam.odometry.dead_reckoning import DeadReckoning
from slam.odometry.error_model import OdometryModel

from ..tracking_results import tracking_result

STEP = np.array([0.1, 0.0, 0.0])  # of odometry between two scans
BEGIN = Odometry(0.0, np.zeros(3))
INFORMATION = 1e6 * np.eye(3)


def certain(_prediction: Prediction) -> bool:
    return True


def compare(_prediction: Prediction, _pose: se2.Pose) -> tuple[None, float]:
    return None, 0.0


def test_both_hypotheses_are_followed_from_where_a_tentative_scan_fits_them() -> None:
    predictor = PosePredictor(DeadReckoning(OdometryModel(OdometryConfig())))
    tentative, alternative = np.array([0.9, 0.3, 0.1]), np.array([0.25, 0.0, 0.2])
    predictor.move_to(np.zeros(3), BEGIN)
    for k in range(2):
        odometry = Odometry(0.1 * k, k * STEP)
        predictor.predict(odometry)
        result = tracking_result(pose=odometry.pose, information=INFORMATION)
        predictor.update(result, odometry, None, certain, compare)
    odometry = Odometry(0.2, 2 * STEP)
    before = predictor.predict(odometry).usual
    np.testing.assert_allclose(before.pose, odometry.pose, atol=1e-9)
    predictor.update(
        tracking_result(TrackingStatus.TENTATIVE, pose=tentative, information=INFORMATION),
        odometry,
        TentativePose(PoseFix(tentative, odometry), Alternative(alternative, 4.0), 3.0),
        certain,
        compare,
    )
    predictions = predictor.predict(Odometry(0.3, 3 * STEP))
    usual, (from_tentative, _even) = predictions.usual, predictions.from_tentative
    np.testing.assert_allclose(usual.pose, se2.compose(alternative, STEP), atol=1e-9)
    assert usual.cost == 4.0
    np.testing.assert_allclose(from_tentative.pose, se2.compose(tentative, STEP), atol=1e-9)
    assert from_tentative.cost == 0.0
    assert predictions.evidence == 3.0


def test_odometry_adds_its_errors_to_those_of_the_pose_that_it_starts_from() -> None:
    model = OdometryModel(OdometryConfig())
    predictor, turned = PosePredictor(DeadReckoning(model)), np.array([0.5, 0.0, 0.5 * np.pi])
    uncertain_ahead = np.diag([0.09, 1e-6, 1e-6])
    predictor.move_to(np.zeros(3), BEGIN)
    exact = np.linalg.inv(predictor.predict(Odometry(0.0, turned)).usual.information)
    predictor.correct(np.zeros(3), uncertain_ahead)
    added = np.linalg.inv(predictor.predict(Odometry(0.1, turned)).usual.information) - exact
    assert np.diag(added) == pytest.approx([1e-6, 0.09, 1e-6], abs=2e-6)  # ahead then is to the right now
    predictor.correct(np.zeros(3))  # a keyframe: the map is known relative to it
    assert np.linalg.inv(predictor.predict(Odometry(0.2, turned)).usual.information) == pytest.approx(exact, rel=1e-9)


def test_without_a_fit_odometry_is_followed_from_the_last_fix() -> None:
    predictor = PosePredictor(DeadReckoning(OdometryModel(OdometryConfig())))
    predictor.move_to(np.zeros(3), BEGIN)
    predictor.predict(BEGIN)
    predictor.update(tracking_result(information=INFORMATION), BEGIN, None, certain, compare)
    moved = Odometry(0.1, STEP)
    predictor.predict(moved)
    result = tracking_result(TrackingStatus.TENTATIVE, pose=np.array([0.9, 0.3, 0.1]))
    predictor.update(result, moved, TentativePose(PoseFix(result.pose, moved), None, 3.0), certain, compare)
    usual = predictor.predict(Odometry(0.2, 2 * STEP)).usual
    np.testing.assert_allclose(usual.pose, 2 * STEP, atol=1e-9)
    assert usual.cost == pytest.approx(-np.log(20.0 / 21.0))  # no more than that of odometry without a slip


def test_the_cost_of_a_slip_follows_from_the_scans_that_slipped_and_is_saved() -> None:
    predictor = PosePredictor(DeadReckoning(OdometryModel(OdometryConfig())))
    costs: list[tuple[float, float]] = []
    for slipped in (False, True):
        for k in range(20):
            odometry = Odometry(0.1 * k, np.zeros(3))
            predictor.predict(odometry)
            predictor.update(tracking_result(slipped=slipped), odometry, None, certain, compare)
        predictions = predictor.predict(Odometry(2.0, np.zeros(3)))
        assert predictions.slip is not None
        costs.append((predictions.usual.cost, predictions.slip.cost))
    # The first of 20 slips followed 20 scans without one, and the others each followed a slip.
    np.testing.assert_allclose(costs, -np.log([[39 / 40, 1 / 40], [1 / 21, 20 / 21]]))
    restored, state = (
        PosePredictor(DeadReckoning(OdometryModel(OdometryConfig()))),
        predictor.state(SmallObjects(), 0.0),
    )
    assert state is not None
    restored.restore(state)
    predictions = restored.predict(Odometry(2.1, np.zeros(3)))
    assert predictions.slip is not None
    assert (predictions.usual.cost, predictions.slip.cost) == costs[-1]
