"""Registration of scans with known walls: rooms, corridors, distant starts, empty scans and empty maps."""

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import CornerPoints, Segments
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import LocalMap, empty_local_map, local_map_around
from slam.matching.likelihood_field import ScanPoints, build_likelihood_field
from slam.matching.line_matcher import NEAR_STARTS, Registration, ScanFeatures, register

ROOM = np.array([[1.0, -2.0, 0.0], [4.0, 0.0, np.pi / 2], [1.0, 2.0, np.pi], [-2.0, 0.5, -np.pi / 2], [1.0, 0.5, 0.5]])
ROOM_HALVES = np.array([3.0, 2.0, 3.0, 1.4, 0.4])
CORRIDOR = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, np.pi]])
CORRIDOR_HALVES = np.array([8.0, 8.0])
NO_POINTS = ScanPoints(np.zeros((0, 2)), np.zeros((0, 2)))
EMPTY_FIELD = build_likelihood_field(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(2))
SIGMAS = np.array([0.002, 0.002])  # metres, radians
LOOSE_PRIOR = np.diag(1 / np.array([0.3, 0.3, np.radians(15.0)]) ** 2)


def build_local_map(frames: np.ndarray, halves: np.ndarray) -> LocalMap:
    """Return a local map of the walls, known to a millimetre and a milliradian."""
    landmarks = Landmarks()
    for frame, half in zip(frames, halves, strict=True):
        landmarks.add_wall(frame, half, 0)
    landmarks.walls.rows["covariance"][:] = 1e-6 * np.eye(2)
    return local_map_around(landmarks, np.zeros(3), 20.0, [np.zeros((3, 3))])


def simulate_scan(pose: np.ndarray, frames: np.ndarray, halves: np.ndarray, seed: int = 0) -> ScanFeatures:
    """Return the walls as seen from a pose, with noise; 70 % of the length of each is visible."""
    random = np.random.default_rng(seed)
    count = len(frames)
    noise = np.column_stack([random.uniform(-0.2, 0.2, count) * halves, SIGMAS * random.normal(size=(count, 2))])
    seen = se2.compose(se2.between(pose, frames), noise)
    covariance = np.tile(np.diag(SIGMAS**2), (count, 1, 1))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
    return ScanFeatures(Segments(seen, 0.7 * halves, covariance), corners, NO_POINTS)


def register_scan(prediction: np.ndarray, scan: ScanFeatures, local_map: LocalMap) -> Registration:
    return register(prediction, LOOSE_PRIOR, NEAR_STARTS, scan, local_map, EMPTY_FIELD, 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_pose_in_room_is_found_from_distant_prediction(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = np.array([random.uniform(0, 2), random.uniform(-1, 0), random.uniform(-3, 3)])
    side, turn = random.uniform(-np.pi, np.pi), np.radians(15.0) * random.uniform(-1, 1)
    start = se2.compose(truth, [0.3 * np.cos(side), 0.3 * np.sin(side), turn])
    found = register_scan(start, simulate_scan(truth, ROOM, ROOM_HALVES, seed), build_local_map(ROOM, ROOM_HALVES))
    error = se2.between(truth, found.pose)
    assert np.hypot(*error[:2]) < 0.006
    assert abs(error[2]) < 0.004
    assert found.overlap_ratio > 0.95
    assert error @ found.information @ error < 25.0


def test_corners_alone_determine_pose() -> None:
    truth, start = np.array([0.3, -0.2, 0.1]), np.array([0.2, -0.1, 0.05])
    landmarks = Landmarks()
    for position, headings in (
        ([4.0, -2.0], [0.0, np.pi / 2]),
        ([4.0, 2.0], [np.pi / 2, np.pi]),
        ([1.0, 2.0], [0, 1.5]),
    ):
        landmarks.add_corner(np.array(position), np.array(headings), np.array([-1, -1]), 0)
    landmarks.corners.rows["covariance"][:] = 1e-6 * np.eye(2)
    local_map = local_map_around(landmarks, np.zeros(3), 20.0, [np.zeros((3, 3))])
    corners = landmarks.corners.rows
    seen = CornerPoints(
        se2.transform(se2.inverse(truth), corners["position"]),
        np.tile(1e-6 * np.eye(2), (3, 1, 1)),
        np.zeros((3, 2), int),
        corners["headings"] - truth[2],
    )
    scan = ScanFeatures(Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))), seen, NO_POINTS)
    found = register_scan(start, scan, local_map)
    np.testing.assert_allclose(found.pose, truth, atol=1e-3)


def test_prediction_determines_position_along_bare_corridor() -> None:
    truth = np.array([0.5, 0.2, 0.05])
    start = truth + np.array([0.2, -0.1, 0.05])
    found = register_scan(
        start, simulate_scan(truth, CORRIDOR, CORRIDOR_HALVES), build_local_map(CORRIDOR, CORRIDOR_HALVES)
    )
    assert found.pose[0] == pytest.approx(start[0], abs=5e-3)
    assert found.pose[1] == pytest.approx(truth[1], abs=6e-3)
    assert found.pose[2] == pytest.approx(truth[2], abs=4e-3)
    c, s = np.cos(found.pose[2]), np.sin(found.pose[2])
    along, across = np.array([c, -s, 0.0]), np.array([s, c, 0.0])
    assert along @ found.information @ along < 1e-6 * (across @ found.information @ across)


def test_clutter_points_determine_position_along_corridor() -> None:
    truth = np.array([0.5, 0.2, 0.05])
    start = truth + np.array([0.12, -0.05, 0.02])
    clutter = np.random.default_rng(3).uniform([-4, -0.9], [4, 0.9], (40, 2))
    field = build_likelihood_field(clutter, clutter, np.zeros(2))
    seen = se2.transform(se2.inverse(truth), clutter)
    scan = simulate_scan(truth, CORRIDOR, CORRIDOR_HALVES)
    scan = ScanFeatures(scan.segments, scan.corners, ScanPoints(seen, seen))
    local_map = build_local_map(CORRIDOR, CORRIDOR_HALVES)
    found = register(start, LOOSE_PRIOR, NEAR_STARTS, scan, local_map, field, 0.0)
    assert found.pose[0] == pytest.approx(truth[0], abs=0.02)
    assert found.point_information[0, 0] > 100.0


def test_wall_seen_from_other_side_is_not_matched() -> None:
    truth = np.array([0.5, 0.2, 0.05])
    turned = CORRIDOR + np.array([0.0, 0.0, np.pi])
    found = register_scan(
        truth, simulate_scan(truth, turned, CORRIDOR_HALVES), build_local_map(CORRIDOR, CORRIDOR_HALVES)
    )
    assert found.overlap_ratio == 0.0
    np.testing.assert_allclose(found.pose, truth, atol=1e-9)
    np.testing.assert_array_equal(found.information, 0.0)


def test_segments_beyond_known_extent_of_walls_are_not_matched() -> None:
    truth = np.zeros(3)
    local_map = build_local_map(ROOM, np.full(len(ROOM), 0.05))
    scan = simulate_scan(truth, ROOM, 0.1 * ROOM_HALVES)
    away = ScanFeatures(
        Segments(
            se2.compose(scan.segments.frame, [1.5, 0.0, 0.0]), scan.segments.half_length, scan.segments.covariance
        ),
        scan.corners,
        NO_POINTS,
    )
    assert register_scan(truth, away, local_map).overlap_ratio == 0.0


@pytest.mark.parametrize("with_map", [True, False])
def test_empty_scan_or_empty_map_returns_prediction(with_map: bool) -> None:
    prediction = np.array([1.0, 2.0, 0.5])
    local_map = build_local_map(ROOM, ROOM_HALVES) if with_map else empty_local_map()
    scan = simulate_scan(prediction, ROOM[: 0 if with_map else 5], ROOM_HALVES[: 0 if with_map else 5])
    found = register_scan(prediction, scan, local_map)
    np.testing.assert_allclose(found.pose, prediction, atol=1e-12)
    np.testing.assert_array_equal(found.information, 0.0)
    assert found.overlap_ratio == 0.0
