"""Wall roughness: estimated from residuals, and added to covariances."""

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from slam.geometry.roughness import Roughness, add_roughness
from slam.geometry.segments import Segments
from slam.mapping.local_map import LocalMap, empty_local_map
from slam.mapping.wall_roughness import WallRoughness


def test_roughness_affects_the_heading_of_short_segments_more() -> None:
    result = add_roughness(np.zeros((2, 2, 2)), np.array([0.5, 1.0]), Roughness(2e-6, 1e-6))
    np.testing.assert_allclose(result[:, 0, 0], 2e-6)
    np.testing.assert_allclose(result[:, 1, 1], [1.2e-5, 3e-6])  # 12 f / length squared


def walls_around(count: int) -> LocalMap:
    """Return a local map of well-observed walls in all directions, known to a millimetre and a milliradian."""
    directions = np.linspace(-np.pi, np.pi, count, endpoint=False)
    frame = np.column_stack([3.0 * np.cos(directions), 3.0 * np.sin(directions), directions + np.pi / 2])
    covariance = np.tile(1e-6 * np.eye(2), (count, 1, 1))
    return replace(
        empty_local_map(), walls=np.arange(count), frame=frame, wall_covariance=covariance,
        observations=np.full(count, 100),
    )  # fmt: skip


def learn(
    offset: float, ends: float, *, wrong: float = 0.0, poses: float = 0.01, walls: int = 12, scans: int = 80
) -> WallRoughness:
    """Return what scans of walls show, with segments, landmarks and poses whose errors are as stated.

    offset, ends  roughness, metres
    wrong         metres by which one segment of each scan is off, as if it belonged to another surface
    poses         standard deviation of the poses that the scans are given at, metres
    """
    random, estimate, local_map = np.random.default_rng(0), WallRoughness(), walls_around(walls)
    halves = np.full(walls, 0.8)
    covariance = np.tile(4e-6 * np.eye(2), (walls, 1, 1))
    own = np.sqrt(np.diagonal(add_roughness(covariance, halves, Roughness(offset**2, ends**2)), axis1=1, axis2=2))
    for _ in range(scans):
        pose = np.array([*random.uniform(-1.0, 1.0, 2), random.uniform(-3.0, 3.0)])
        errors = np.zeros((walls, 3))
        errors[:, 1:] = own * random.normal(size=(walls, 2)) - 1e-3 * random.normal(size=(walls, 2))
        errors[random.integers(walls), 1] += wrong
        frames = se2.between(pose, se2.compose(local_map.frame, errors))
        found = se2.compose(pose, poses * np.array([1.0, 1.0, 0.5]) * random.normal(size=3))
        estimate.add_scan(found, Segments(frames, halves, covariance), local_map, np.arange(walls))
    return estimate


@pytest.mark.parametrize(("offset", "ends"), [(0.0, 0.0), (0.004, 0.004), (0.01, 0.003)])
def test_errors_of_segments_walls_and_poses_are_not_roughness(offset: float, ends: float) -> None:
    """Monte Carlo."""
    found = np.sqrt(learn(offset, ends).variances)
    assert found == pytest.approx(np.array([offset, ends]), rel=0.2, abs=1e-3)


def test_wrong_associations_hardly_change_the_roughness() -> None:
    """One of twelve segments is off by four standard deviations, which doubles the mean square of all."""
    right, wrong = learn(0.005, 0.005), learn(0.005, 0.005, wrong=0.02)
    assert np.sqrt(wrong.variances) == pytest.approx(np.sqrt(right.variances), rel=0.3)


def test_the_pose_near_which_a_scan_is_compared_does_not_matter() -> None:
    """Only what the other walls say about a segment counts."""
    at_true_poses, off = learn(0.004, 0.004, poses=0.0), learn(0.004, 0.004)
    assert np.sqrt(at_true_poses.variances) == pytest.approx(np.sqrt(off.variances), rel=0.02)


def test_walls_that_nothing_else_determines_do_not_count() -> None:
    """Of three walls around the robot, any two leave the way along the third one's normal uncertain or not at all."""
    found = learn(0.005, 0.005, walls=3, scans=300)
    assert np.sqrt(found.variances.offset) == pytest.approx(0.005, rel=0.3)


def test_a_single_wall_shows_no_roughness() -> None:
    """Nothing else tells where the robot was: the pose that is given is not trusted."""
    estimate, local_map, random = WallRoughness(), walls_around(1), np.random.default_rng(0)
    initial, covariance = estimate.variances, np.tile(1e-6 * np.eye(2), (1, 1, 1))
    for _ in range(300):
        frame = se2.between(np.zeros(3), local_map.frame)
        frame[:, 1] += 0.02 * random.normal()
        estimate.add_scan(np.zeros(3), Segments(frame, np.full(1, 0.8), covariance), local_map, np.arange(1))
    assert max(estimate.variances) <= max(initial)
