"""Bends of walls are estimated from what different keyframes saw, and explain the errors of walls."""

import numpy as np
import pytest

from slam.estimation.wall_bends import estimate_wall_bends
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.graph.wall_bends import BendResponse, WallBends
from slam.mapping.keyframes import LandmarkIds
from slam.mapping.mapper import Mapper
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints
from slam.preprocessing.preprocessor import ProcessedScan

LENGTH, SPACING = 0.35, 0.05
"""Metres: correlation length of the bends, and distance of neighbouring points."""
HALF_WALL, HALF_VIEW = 3.0, 1.2
"""Metres: half the length of a wall, and of what one keyframe sees of it."""
VIEWS = 20
NOISE = 0.01
"""Metres, of a single point."""
POSE_SIGMAS = np.array([0.0, 0.01, 0.005])
"""Errors of the keyframes' poses, far larger than those of a real drive."""
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))


def drive_past(
    walls: int, sigma: float, random: np.random.Generator, frame: float = 0.0
) -> tuple[Mapper, list[ProcessedScan], Floats]:
    """Return a map of parallel walls, the scans of its keyframes, and the places and bends (n,) of the last wall.

    The frames of the walls are `frame` metres beyond their middle.
    """
    mapper, scans, poses = Mapper(), [], []
    places = np.arange(-HALF_WALL, HALF_WALL, SPACING)
    covariance = np.exp(-0.5 * (np.subtract.outer(places, places) / LENGTH) ** 2)
    root = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(places)))
    for wall in range(walls):
        bends = sigma * root @ random.standard_normal(len(places))
        mapper.landmarks.add_wall(np.array([frame, 10.0 * wall, 0.0]), HALF_WALL, 0)
        for middle in np.linspace(HALF_VIEW - HALF_WALL, HALF_WALL - HALF_VIEW, VIEWS):
            seen = np.abs(places - middle) < HALF_VIEW
            across = bends[seen] + random.normal(0.0, NOISE, int(seen.sum()))
            points = np.column_stack([places[seen] - middle, across])
            segments = Segments(np.zeros((1, 3)), np.array([HALF_VIEW]), np.zeros((1, 2, 2)))
            features = ScanFeatures(segments, NO_CORNERS, ScanPoints(points))
            scans.append(ProcessedScan(float(len(scans)), np.zeros(3), features))
            poses.append(np.array([middle, 10.0 * wall, 0.0]) + random.normal(0.0, POSE_SIGMAS))
            mapper.landmark_ids.append(LandmarkIds(np.array([wall]), np.zeros(0, dtype=np.int64)))
    mapper.keyframe_poses, mapper.keyframe_count = np.array(poses), len(poses)
    return mapper, scans, np.column_stack([places, bends])


def test_bends_are_found_despite_noise_and_errors_of_poses() -> None:
    mapper, scans, _ = drive_past(20, 0.004, np.random.default_rng(1))
    bends = estimate_wall_bends(mapper, scans)
    assert bends.sigma == pytest.approx(0.004, rel=0.15)
    assert bends.length == LENGTH


def test_straight_walls_have_no_bends() -> None:
    mapper, scans, _ = drive_past(20, 0.0, np.random.default_rng(2))
    assert estimate_wall_bends(mapper, scans).sigma < 0.001


def test_bends_do_not_depend_on_the_frames_of_walls() -> None:
    middle, end = (
        estimate_wall_bends(*drive_past(5, 0.004, np.random.default_rng(4), frame)[:2]) for frame in (0.0, -1.0)
    )
    assert end.sigma == pytest.approx(middle.sigma, rel=1e-6)
    assert end.length == middle.length


@pytest.mark.slow
def test_the_covariance_is_that_of_the_lines_fitted_to_bent_walls() -> None:
    random, sigma, drives = np.random.default_rng(3), 0.004, 200
    mapper, scans, _ = drive_past(20, sigma, random)
    covariance = estimate_wall_bends(mapper, scans).of_walls([19])[0]
    squares = []
    for _ in range(drives):
        places, bends = drive_past(1, sigma, random)[2].T
        views = sum((np.abs(places - m) < HALF_VIEW) for m in np.linspace(HALF_VIEW - 3.0, 3.0 - HALF_VIEW, VIEWS))
        slope, offset = np.polyfit(places, bends, 1, w=np.sqrt(views))
        error = np.array([offset, slope])
        squares.append(error @ np.linalg.solve(covariance, error) / 2.0)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)


def test_bends_of_two_walls_are_independent() -> None:
    bends = WallBends(0.01, 0.5, {4: BendResponse(np.array([0.0, 5.0]), np.array([[2.0, 0.0], [0.0, 3.0]]))})
    np.testing.assert_allclose(bends.of_all([7, 4]), 0.01**2 * np.diag([0.0, 0.0, 4.0, 9.0]), atol=1e-12)


def test_lines_fitted_to_the_same_bends_differ_only_by_what_was_seen() -> None:
    places, weights = np.array([0.5, 1.0, 1.5]), np.array([[0.2, 0.3, 0.5], [-1.0, 0.0, 1.0]])
    response = BendResponse(places, weights)
    same = BendResponse(places + 2.0, np.array([[1.0, -2.0], [0.0, 1.0]]) @ weights)  # from a frame 2 m back
    np.testing.assert_allclose(response.at(0.7).minus(same.at(2.7)).covariance(1.0, 0.5), 0.0, atol=1e-12)
    far = BendResponse(places + 50.0, weights)
    expected = response.covariance(1.0, 0.5) + far.covariance(1.0, 0.5)
    np.testing.assert_allclose(response.minus(far).covariance(1.0, 0.5), expected, atol=1e-12)


def test_a_map_without_scans_has_no_bends() -> None:
    assert estimate_wall_bends(Mapper(), []).sigma == 0.0
