"""Registration of scans with known walls: rooms, corridors, distant starts, empty scans and empty maps."""

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from slam.geometry.roughness import Roughness
from slam.geometry.segments import CornerPoints, Segments
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import LocalMap, empty_local_map, local_map_around
from slam.matching.distance_field import DistanceField
from slam.matching.line_matcher import Registration, register
from slam.matching.point_matcher import POINT_SPACING, Prediction, match_points
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import FINE_SIGMA, ScanPoints, segments_of, surface_points

from ..outlines import NO_SEGMENTS

SMOOTH = Roughness(0.0, 0.0)
ROOM = np.array([[1.0, -2.0, 0.0], [4.0, 0.0, np.pi / 2], [1.0, 2.0, np.pi], [-2.0, 0.5, -np.pi / 2], [1.0, 0.5, 0.5]])
ROOM_HALVES = np.array([3.0, 2.0, 3.0, 1.4, 0.4])
CORRIDOR = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, np.pi]])
CORRIDOR_HALVES = np.array([8.0, 8.0])
NO_POINTS = ScanPoints(np.zeros((0, 2)))
EMPTY_FIELD = DistanceField.empty(np.zeros(2), 2.0)
SIGMAS = np.array([0.002, 0.002])  # metres, radians
LOOSE_PRIOR = np.diag(1 / np.array([0.3, 0.3, np.radians(15.0)]) ** 2)


def build_local_map(frames: np.ndarray, halves: np.ndarray) -> LocalMap:
    """Return a local map of the walls, known to a millimetre and a milliradian."""
    landmarks = Landmarks()
    for frame, half in zip(frames, halves, strict=True):
        landmarks.add_wall(frame, half, 0)
    landmarks.walls.rows["covariance"][:] = 1e-6 * np.eye(2)
    return local_map_around(landmarks, np.zeros(3), 20.0, np.zeros((1, 3, 3)))


def simulate_scan(pose: np.ndarray, frames: np.ndarray, halves: np.ndarray, seed: int = 0) -> ScanFeatures:
    """Return the walls as seen from a pose, with noise; 70 % of the length of each is visible."""
    random = np.random.default_rng(seed)
    count = len(frames)
    noise = np.column_stack([random.uniform(-0.2, 0.2, count) * halves, SIGMAS * random.normal(size=(count, 2))])
    seen = se2.compose(se2.between(pose, frames), noise)
    covariance = np.tile(np.diag(SIGMAS**2), (count, 1, 1))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
    return ScanFeatures(Segments(seen, 0.7 * halves, covariance), corners, NO_POINTS)


def wall_points(frames: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Return points (n, 2) every two centimetres along the walls."""
    along = [np.arange(-half, half, 0.02) for half in halves]
    return np.concatenate(
        [se2.transform(f, np.column_stack([a, np.zeros(len(a))])) for f, a in zip(frames, along, strict=True)]
    )


def field_of(points: np.ndarray) -> DistanceField:
    """Return a distance field of points (n, 2) in the map, seen from its origin."""
    field = DistanceField.empty(np.zeros(2))
    field.insert(np.zeros(3), points)
    return field


def register_scan(prediction: np.ndarray, scan: ScanFeatures, local_map: LocalMap) -> Registration:
    """Register a scan without points, starting at the prediction."""
    return register(prediction, prediction, LOOSE_PRIOR, scan, np.zeros((0, 6)), local_map, EMPTY_FIELD, SMOOTH)


def match_and_register(
    prediction: np.ndarray, scan: ScanFeatures, local_map: LocalMap, field: DistanceField
) -> Registration:
    """Register a scan, starting where its points fit best near the prediction."""
    points = surface_points(scan.points.xy, scan.segments, POINT_SPACING)
    start = match_points(field, points, [Prediction(prediction, LOOSE_PRIOR)])[0].pose
    return register(start, prediction, LOOSE_PRIOR, scan, points, local_map, field, SMOOTH)


@pytest.mark.parametrize("seed", range(12))
def test_pose_in_room_is_found_from_distant_prediction(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = np.array([random.uniform(0, 2), random.uniform(-1, 0), random.uniform(-3, 3)])
    side, turn = random.uniform(-np.pi, np.pi), np.radians(15.0) * random.uniform(-1, 1)
    start = se2.compose(truth, [0.3 * np.cos(side), 0.3 * np.sin(side), turn])
    points = wall_points(ROOM, ROOM_HALVES)
    noisy = se2.transform(se2.inverse(truth), points) + random.normal(0.0, 0.005, points.shape)
    scan = replace(simulate_scan(truth, ROOM, ROOM_HALVES, seed), points=ScanPoints(noisy))
    found = match_and_register(start, scan, build_local_map(ROOM, ROOM_HALVES), field_of(points))
    error = se2.between(truth, found.pose)
    assert np.hypot(*error[:2]) < 0.006
    assert abs(error[2]) < 0.004
    assert found.overlap_ratio > 0.95
    assert error @ found.information @ error < 25.0
    assert error @ found.total_information @ error < 25.0


def test_corners_determine_position_along_bare_corridor() -> None:
    truth, start = np.array([0.3, -0.2, 0.1]), np.array([0.2, -0.1, 0.05])
    landmarks = Landmarks()
    for frame, half in zip(CORRIDOR, CORRIDOR_HALVES, strict=True):
        landmarks.add_wall(frame, half, 0)
    landmarks.walls.rows["covariance"][:] = 1e-6 * np.eye(2)
    for position, headings in (
        ([4.0, -2.0], [0.0, np.pi / 2]),
        ([4.0, 2.0], [np.pi / 2, np.pi]),
        ([1.0, 2.0], [0, 1.5]),
    ):
        landmarks.add_corner(np.array(position), np.array(headings), np.array([-1, -1]), 0)
    landmarks.corners.rows["covariance"][:] = 1e-6 * np.eye(2)
    local_map = local_map_around(landmarks, np.zeros(3), 20.0, np.zeros((1, 3, 3)))
    corners = landmarks.corners.rows
    seen = CornerPoints(
        se2.transform(se2.inverse(truth), corners["position"]),
        np.tile(1e-6 * np.eye(2), (3, 1, 1)),
        np.zeros((3, 2), int),
        corners["headings"] - truth[2],
    )
    walls = Segments(se2.between(truth, CORRIDOR), 0.7 * CORRIDOR_HALVES, np.tile(1e-6 * np.eye(2), (2, 1, 1)))
    scan = ScanFeatures(walls, seen, NO_POINTS)
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
    walls = wall_points(CORRIDOR, CORRIDOR_HALVES)
    on_walls, seen = (se2.transform(se2.inverse(truth), points) for points in (walls, clutter))
    scan = simulate_scan(truth, CORRIDOR, CORRIDOR_HALVES)
    scan = replace(scan, points=ScanPoints(np.concatenate([on_walls, seen])))
    local_map = build_local_map(CORRIDOR, CORRIDOR_HALVES)
    found = match_and_register(start, scan, local_map, field_of(np.concatenate([walls, clutter])))
    assert found.pose[0] == pytest.approx(truth[0], abs=0.02)
    assert found.point_information[0, 0] > 100.0


def points_on(segments: Segments) -> np.ndarray:
    """Return points (p, 6) with normals on the segments, nearly from end to end."""
    points = wall_points(segments.frame, 0.99 * segments.half_length)
    return surface_points(points, segments, POINT_SPACING)


@pytest.mark.parametrize("displacement", [0.0, 0.05])
def test_points_on_matched_walls_count_by_the_walls_alone(displacement: float) -> None:
    truth = np.array([0.5, 0.2, 0.05])
    scan = simulate_scan(truth, ROOM, ROOM_HALVES)
    field = field_of(wall_points(ROOM, ROOM_HALVES) + displacement)
    walls, points = build_local_map(ROOM, ROOM_HALVES), points_on(scan.segments)
    found = register(truth, truth, LOOSE_PRIOR, scan, points, walls, field, SMOOTH)
    np.testing.assert_array_equal(found.point_information, 0.0)
    np.testing.assert_array_equal(found.total_information, found.information)
    np.testing.assert_array_equal(found.pose, register_scan(truth, scan, walls).pose)


def test_points_on_walls_that_are_not_known_count_by_the_field() -> None:
    truth = np.array([0.5, 0.2, 0.05])
    start = se2.compose(truth, [0.05, -0.04, 0.01])
    scan = simulate_scan(truth, ROOM, ROOM_HALVES)
    points, field = points_on(scan.segments), field_of(wall_points(ROOM, ROOM_HALVES))
    found = register(start, start, LOOSE_PRIOR, scan, points, empty_local_map(), field, SMOOTH)
    np.testing.assert_array_equal(found.information, 0.0)
    np.testing.assert_allclose(found.pose, truth, atol=6e-3)  # the segments have an error of 2 mm
    assert 0.5 < np.trace(found.point_information[:2, :2]) / (len(points) / FINE_SIGMA**2) < 1.0
    known = build_local_map(ROOM[:1], ROOM_HALVES[:1])  # one of five walls
    part = register(start, start, LOOSE_PRIOR, scan, points, known, field, SMOOTH)
    others = points[segments_of(points, scan.segments) != 0]
    without = register(start, start, LOOSE_PRIOR, scan, others, known, field, SMOOTH)
    np.testing.assert_array_equal(part.point_information, without.point_information)
    np.testing.assert_array_equal(part.pose, without.pose)
    assert 0 < len(others) < len(points)
    assert np.trace(part.information) > 0.0


def test_pose_of_the_points_is_independent_of_the_walls() -> None:
    truth, displacement = np.array([0.5, 0.2, 0.05]), np.array([0.03, 0.05])
    random = np.random.default_rng(3)
    objects = random.uniform([-4, -0.9], [4, 0.9], (40, 2))
    clutter = np.repeat(objects, 2, axis=0) + random.normal(0.0, 0.005, (80, 2))  # two beams meet each object
    scan = simulate_scan(truth, CORRIDOR, CORRIDOR_HALVES)
    points = surface_points(se2.transform(se2.inverse(truth), clutter), NO_SEGMENTS, POINT_SPACING)
    walls, field = build_local_map(CORRIDOR, CORRIDOR_HALVES), field_of(clutter + displacement)
    found = register(truth, truth, LOOSE_PRIOR, scan, points, walls, field, SMOOTH)
    assert found.pose[0] == pytest.approx(truth[0] + displacement[0], abs=2e-3)  # the walls do not determine it
    assert found.pose[1] == pytest.approx(truth[1], abs=4e-3)
    np.testing.assert_allclose(found.point_pose[:2], truth[:2] + displacement, atol=5e-3)


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
