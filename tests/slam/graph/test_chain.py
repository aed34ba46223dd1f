"""Smoothing of a chain of poses."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from drivers import se2
from slam.graph.chain import smooth_chain
from slam.graph.factors import FactorKind
from slam.graph.gtsam_factors import KERNELS, from_pose2, to_pose2

COUNT = 30


def chain(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the true poses of a chain, and what is known of them: the arguments of `smooth_chain`."""
    steps = np.column_stack([np.full(COUNT - 1, 0.3), np.zeros(COUNT - 1), random.normal(0.0, 0.2, COUNT - 1)])
    poses = [np.array([1.0, 2.0, 3.0])]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    truth = np.array(poses)
    measured = se2.compose(truth, random.normal(0.0, 1.0, (COUNT, 3)) * [0.02, 0.02, 0.01])
    motions = se2.compose(steps, random.normal(0.0, 1.0, (COUNT - 1, 3)) * [0.01, 0.01, 0.005])
    informations = np.tile(np.diag(np.array([0.02, 0.02, 0.01]) ** -2.0), (COUNT, 1, 1))
    return truth, measured, informations, motions, np.tile(np.diag([1e-4, 1e-4, 25e-6]), (COUNT - 1, 1, 1))


def error(poses: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt((se2.between(truth, poses)[:, :2] ** 2).sum(axis=1).mean()))


def test_result_is_that_of_gtsam() -> None:
    _, measured, informations, motions, covariances = chain(np.random.default_rng(1))
    motions[7] = se2.compose(motions[7], [0.5, 0.2, 0.3])
    informations[12:15, 0] = informations[12:15, :, 0] = 0.0
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(measured):
        values.insert(X(k), to_pose2(pose))
        noise = gtsam.noiseModel.Gaussian.Information(informations[k] + 1e-6 * np.eye(3))
        graph.add(gtsam.PriorFactorPose2(X(k), to_pose2(pose), noise))
    for k, motion in enumerate(motions):
        noise = gtsam.noiseModel.Gaussian.Covariance(covariances[k])
        robust = gtsam.noiseModel.Robust.Create(KERNELS[FactorKind.SCAN_MATCH], noise)
        graph.add(gtsam.BetweenFactorPose2(X(k), X(k + 1), to_pose2(motion), robust))
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    expected = [from_pose2(solved.atPose2(X(k))) for k in range(COUNT)]
    np.testing.assert_allclose(smooth_chain(measured, informations, motions, covariances), expected, atol=1e-6)


def test_smoothing_reduces_the_errors_and_ignores_a_slip() -> None:
    truth, measured, informations, motions, covariances = chain(np.random.default_rng(2))
    smoothed = smooth_chain(measured, informations, motions, covariances)
    assert error(smoothed, truth) < 0.7 * error(measured, truth)
    motions[10] = [1.5, 0.0, 0.0]
    with_slip = smooth_chain(measured, informations, motions, covariances)
    assert error(with_slip, truth) < 1.2 * error(smoothed, truth)


@pytest.mark.parametrize("count", [1, 2])
def test_short_chains_stay_where_they_are_measured(count: int) -> None:
    truth, _, informations, _, covariances = chain(np.random.default_rng(3))
    motions = se2.between(truth[: count - 1], truth[1:count]).reshape(-1, 3)
    smoothed = smooth_chain(truth[:count], informations[:count], motions, covariances[: count - 1])
    np.testing.assert_allclose(smoothed, truth[:count], atol=1e-9)
