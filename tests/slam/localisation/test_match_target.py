"""Matching of a scan to landmarks and distance field together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers import se2
from slam.geometry.roughness import Roughness
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.match_target import MatchTarget
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import empty_local_map, local_map_around
from slam.matching.point_matcher import Prediction
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import WEIGHT, ScanPoints

from ..outlines import noisy_field, outline, scan_points, visible, with_noise

SMOOTH = Roughness(0.0, 0.0)
ROOM = outline([(0, 0), (5, 0), (5, 4), (0, 4)])
WALLS = np.array([[2.5, 0.0, 0.0], [5.0, 2.0, 0.5 * np.pi], [2.5, 4.0, np.pi], [0.0, 2.0, -0.5 * np.pi]])
HALVES = np.array([2.5, 2.0, 2.5, 2.0])
TRUTH = np.array([1.5, 1.7, 0.4])
PREDICTION = Prediction(se2.compose(TRUTH, [0.08, -0.06, 0.03]), np.diag(np.array([0.1, 0.1, 0.05]) ** -2.0))
FIELD = noisy_field(ROOM, np.array([2.0, 1.5, 0.0]))


def scan_of(points: Floats, pose: Floats) -> ScanFeatures:
    """Return a scan of the room, in which `points` (n, 2) in the map are hit, with the segments of the room's walls."""
    seen = with_noise(visible(points, pose), np.random.default_rng(1))
    segments = Segments(se2.between(pose, WALLS), 0.9 * HALVES, np.tile(4e-6 * np.eye(2), (4, 1, 1)))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
    return ScanFeatures(segments, corners, ScanPoints(seen))


def room_target() -> MatchTarget:
    """Return the room's walls and field."""
    landmarks = Landmarks()
    for frame, half in zip(WALLS, HALVES, strict=True):
        landmarks.add_wall(frame, half, 0)
    landmarks.walls.rows["covariance"][:] = 1e-6 * np.eye(2)
    return MatchTarget(local_map_around(landmarks, TRUTH, 20.0, np.zeros((1, 3, 3))), FIELD, SMOOTH)


def test_scan_of_a_known_room_is_matched_with_walls_and_points() -> None:
    match = room_target().match(scan_of(ROOM, TRUTH), [PREDICTION])
    for pose in (match.points.pose, match.registration.pose):
        error = se2.between(TRUTH, pose)
        assert np.hypot(*error[:2]) < 0.004
        assert abs(error[2]) < 0.002
    assert match.points.prediction is PREDICTION
    assert match.registration.overlap_ratio > 0.9
    assert match.fit > 0.95
    assert match.score > 1.8
    assert match.plausible
    assert not match.poor


def test_lines_fitted_to_a_rough_surface_do_not_move_the_pose() -> None:
    scan = scan_of(ROOM, TRUTH)
    off = se2.compose(scan.segments.frame, np.array([0.0, 0.03, 0.0]))  # all lines are 3 cm before their surfaces
    match = room_target().match(replace(scan, segments=replace(scan.segments, frame=off)), [PREDICTION])
    assert np.hypot(*se2.between(TRUTH, match.points.pose)[:2]) < 0.004
    one = replace(scan.segments, frame=off[:2], half_length=HALVES[:2], covariance=scan.segments.covariance[:2])
    match = room_target().match(replace(scan, segments=one), [PREDICTION])
    assert np.hypot(*se2.between(TRUTH, match.points.pose)[:2]) < 0.004
    assert np.hypot(*se2.between(TRUTH, match.registration.pose)[:2]) > 0.01  # where features are associated


def test_points_replace_walls_that_are_not_known() -> None:
    target = replace(room_target(), landmarks=empty_local_map())
    match = target.match(scan_of(ROOM, TRUTH), [PREDICTION])
    error = se2.between(TRUTH, match.registration.pose)
    assert np.hypot(*error[:2]) < 0.006
    assert match.registration.overlap_ratio == 0.0
    np.testing.assert_array_equal(match.registration.information, 0.0)
    assert np.linalg.eigvalsh(match.registration.point_information)[0] > 1e3
    assert match.plausible


def test_scan_of_another_place_is_not_plausible() -> None:
    other = outline([(0.6, 0.9), (2.6, 0.9), (2.6, 2.4), (0.6, 2.4)])  # inside the room, where it was seen empty
    narrow = Prediction(TRUTH, 1e4 * np.eye(3))
    scan = replace(scan_of(other, TRUTH), segments=Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2))))
    match = room_target().match(scan, [narrow])
    assert match.poor
    assert not match.plausible


def test_the_map_explains_a_scan_as_far_as_it_shows_its_points() -> None:
    none = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    known = room_target().match(replace(scan_of(ROOM, TRUTH), segments=none), [PREDICTION])
    assert known.explained > 0.9
    beyond = outline([(0, 0), (5, 0), (5, 1), (9, 1), (9, 3), (5, 3), (5, 4), (0, 4)])  # a part is behind a wall
    extended = room_target().match(replace(scan_of(beyond, TRUTH), segments=none), [PREDICTION])
    assert extended.explained < known.explained - 0.1


@pytest.mark.parametrize("after_gap", [False, True])
def test_odometry_holds_after_a_gap_against_one_of_many_places_that_look_alike(after_gap: bool) -> None:
    """After a gap, odometry leads into an unknown room like the mapped one, of which a corner was seen before.

    An even motion leads back to the mapped room. Odometry is off by a little more than its covariance says.
    """
    to_copy, pose = np.array([12.0, 0.0, 0.0]), np.array([1.5, 1.7, 0.0])
    field = noisy_field(ROOM, pose, half_width=20.0)
    corner = outline([(0, 0), (0.8, 0), (0, 0), (0, 0.8)])
    field.insert(pose + to_copy, scan_points(corner + to_copy[:2], pose + to_copy))
    by_odometry = Prediction(pose + to_copy + [0.35, 0.0, 0.0], np.diag(np.array([0.1, 0.1, 0.02]) ** -2.0))
    even = Prediction(pose, np.diag(np.array([5.0, 5.0, 0.02]) ** -2.0))
    target = MatchTarget(empty_local_map(), field, SMOOTH)
    match = target.match(scan_of(ROOM, pose), [by_odometry, even], earlier_evidence=0.0, after_gap=after_gap)
    assert (match.points.prediction is by_odometry) is after_gap
    assert np.hypot(*(match.points.pose - (pose + to_copy if after_gap else pose))[:2]) < 0.05


@pytest.mark.parametrize("earlier", [0.0, 3.0])
def test_the_evidence_of_scans_in_a_row_against_odometry_adds_up(earlier: float) -> None:
    """In a bare corridor, a post that counts little shows that the robot has not moved by 0.4 m, as odometry says.

    One such scan is too little evidence. With that of an earlier scan it suffices.
    """
    pose, known = np.array([0.0, 1.5, 0.0]), np.diag(np.array([0.05, 0.05, 0.02]) ** -2.0)
    post = np.column_stack([np.full(8, 2.0), np.linspace(1.0, 1.2, 8)])
    corridor = np.vstack([outline([(-15, 0), (15, 0)]), outline([(-15, 3), (15, 3)]), post])
    target = MatchTarget(empty_local_map(), noisy_field(corridor, pose, half_width=20.0), SMOOTH)
    scan = scan_of(corridor, pose)
    points = scan.surface_points()
    points[:, WEIGHT] = 0.2
    moved, stands = Prediction(se2.compose(pose, [0.4, 0.0, 0.0]), known), Prediction(pose, known)
    match = target.match(scan, [moved, stands], points, earlier_evidence=earlier)
    assert (match.points.prediction is stands) is (earlier > 0.0)
    assert (match.evidence > earlier) is (earlier > 0.0)
