"""Fusion of the poses of scans by points and by landmarks."""

import numpy as np
import pytest

from drivers import se2
from slam.estimation.refinement.pose_fusion import fuse_poses
from slam.geometry.segments import Floats

SCANS = 2000
POINTS = np.diag(np.array([0.004, 0.004, 0.001]) ** -2.0)
LANDMARKS = np.diag(np.array([0.001, 0.001, 0.0003]) ** -2.0)


def informations(one: Floats) -> Floats:
    return np.tile(one, (SCANS, 1, 1))


def noisy(truth: Floats, information: Floats, seed: int) -> Floats:
    errors = np.random.default_rng(seed).multivariate_normal(np.zeros(3), np.linalg.inv(information), SCANS)
    return se2.compose(truth, errors)


def path() -> Floats:
    return np.random.default_rng(0).uniform([-9.0, -9.0, -3.0], [9.0, 9.0, 3.0], (SCANS, 3))


def position_error(poses: Floats, truth: Floats) -> float:
    return float(np.sqrt(np.mean((poses - truth)[:, :2] ** 2)))


def test_consistent_poses_are_weighted_by_their_information() -> None:
    truth = path()
    points, registered = noisy(truth, POINTS, 1), noisy(truth, LANDMARKS, 2)
    fused, information = fuse_poses(points, informations(POINTS), registered, informations(LANDMARKS))
    assert position_error(fused, truth) < position_error(registered, truth)
    error = se2.between(truth, fused)
    nees = float(np.mean(np.einsum("ni,nij,nj->n", error, information, error)) / 3.0)
    assert nees == pytest.approx(1.0, abs=0.15)


def test_landmarks_count_little_if_they_contradict_the_points() -> None:
    truth = path()
    rough = np.diag(np.array([0.02, 0.02, 0.004]) ** -2.0)  # what registration errs by, not what it states
    points, registered = noisy(truth, POINTS, 1), noisy(truth, rough, 2)
    fused, _ = fuse_poses(points, informations(POINTS), registered, informations(LANDMARKS))
    assert position_error(fused, truth) < 1.02 * position_error(points, truth)


def test_directions_that_only_one_determines_are_taken_from_it() -> None:
    truth = path()
    across, along = np.diag([0.0, 1e6, 1e6]), np.diag([1e6, 0.0, 0.0])
    points, registered = se2.compose(truth, [0.1, 0.0, 0.0]), se2.compose(truth, [0.0, 0.1, 0.0])
    fused, _ = fuse_poses(points, informations(across), registered, informations(along))
    np.testing.assert_allclose(se2.between(truth, fused), np.zeros((SCANS, 3)), atol=1e-3)


def test_no_scans_give_no_poses() -> None:
    none, nothing = np.zeros((0, 3)), np.zeros((0, 3, 3))
    fused, information = fuse_poses(none, nothing, none, nothing)
    assert fused.shape == (0, 3)
    assert information.shape == (0, 3, 3)
