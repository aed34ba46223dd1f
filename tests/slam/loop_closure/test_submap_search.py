"""Search for a submap in an old place: it is found there only, and walls that should have hidden it count."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Floats, Segments
from slam.loop_closure.criteria import MIN_KNOWN, MIN_LOOP_FIT
from slam.loop_closure.submap_search import Submap, build_submap, improve, search_submap
from slam.matching.offset_tiles import FIELD_CELL
from slam.matching.point_matcher import POINT_SPACING
from slam.matching.scan_points import surface_points

from ..outlines import outline, with_noise

ROOM = outline([(0, 0), (5, 0), (5, 2), (3.5, 2), (3.5, 4), (0, 4)])  # angular, without symmetry
WALL = np.column_stack([np.full(100, 1.8), np.linspace(0.0, 2.0, 100)])  # across the room
HALL = outline([(-6, -6), (11, -6), (11, 10), (-6, 10)])
OLD = np.array([1.5, 1.5, 0.4])  # frame of the old submap in the room
NO_SEGMENTS = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
REACH, TURN = 1.5, np.radians(24.0)


def submap_of(points: Floats, pose: Floats, seed: int = 0) -> Submap:
    """Return a submap of points (p, 2) from two keyframes, the first of them at `pose`."""
    motions = np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.5]])
    random = np.random.default_rng(seed)
    own = [se2.transform(se2.inverse(se2.compose(pose, motion)), with_noise(points, random)) for motion in motions]
    return build_submap(motions, [surface_points(scan, NO_SEGMENTS, POINT_SPACING) for scan in own], 15.0)


@pytest.mark.parametrize("turn", [-15.0, 15.0])
@pytest.mark.parametrize("side", [0.0, 1.6, 3.1, 4.7])
def test_displaced_submap_is_found(side: float, turn: float) -> None:
    pose = np.array([2.0, 1.2, -1.0])
    relative = se2.between(OLD, pose)
    prediction = se2.compose(relative, [np.cos(side), np.sin(side), np.radians(turn)])
    best, *others = search_submap(submap_of(ROOM, pose, 1), submap_of(ROOM, OLD), prediction, REACH, TURN)
    error = se2.between(relative, best.pose)
    assert np.hypot(*error[:2]) < FIELD_CELL
    assert abs(error[2]) < np.radians(1.0)
    assert error @ np.linalg.solve(best.covariance, error) < 11.3  # chi-square, 3 dof, 99 %
    assert min(best.fit, best.known) > 0.95
    assert all(other.fit * other.known < 0.9 * best.fit for other in others)


def test_points_of_a_submap_are_those_of_its_keyframes_in_its_frame() -> None:
    random = np.random.default_rng(4)
    poses = np.column_stack([random.uniform(-2.0, 2.0, (3, 2)), random.uniform(-np.pi, np.pi, 3)])
    scans = [random.uniform(-3.0, 3.0, (count, 5)) for count in (5, 0, 8)]
    moved = build_submap(poses, scans, 10.0).points
    expected = [
        np.hstack([se2.transform(pose, scan[:, :2]), se2.transform([0.0, 0.0, pose[2]], scan[:, 2:4]), scan[:, 4:]])
        for pose, scan in zip(poses, scans, strict=True)
    ]
    np.testing.assert_allclose(moved, np.concatenate(expected), atol=1e-12)


def test_nothing_matches_in_an_old_place_that_was_not_seen() -> None:
    old = build_submap(np.zeros((1, 3)), [np.zeros((0, 6))], 15.0)
    found = search_submap(submap_of(ROOM, OLD), old, np.zeros(3), REACH, TURN)
    assert all(match.known < MIN_KNOWN for match in found)


def test_nothing_fits_in_an_old_place_that_was_seen_empty() -> None:
    submap, hall = submap_of(ROOM, OLD), submap_of(HALL, OLD)
    assert all(match.fit < MIN_LOOP_FIT for match in search_submap(submap, hall, np.zeros(3), REACH, TURN))
    match = improve(submap, hall, np.zeros(3))
    assert match.known > MIN_KNOWN
    assert match.fit < MIN_LOOP_FIT


def test_old_wall_that_should_have_hidden_the_submap_lowers_the_fit() -> None:
    submap = submap_of(ROOM, OLD, 1)
    plain = search_submap(submap, submap_of(ROOM, OLD), np.zeros(3), REACH, TURN)[0]
    hidden = search_submap(submap, submap_of(np.concatenate([ROOM, WALL]), OLD), np.zeros(3), REACH, TURN)[0]
    np.testing.assert_allclose(hidden.pose, plain.pose, atol=FIELD_CELL)
    assert hidden.fit < plain.fit - 0.05


def test_submap_beside_the_old_place_is_known_in_part_only() -> None:
    beyond = outline([(5.1, 0), (11, 0), (11, 4), (5.1, 4)])
    submap = submap_of(np.concatenate([ROOM, beyond]), OLD, 1)
    best = search_submap(submap, submap_of(ROOM, OLD), np.zeros(3), REACH, TURN)[0]
    np.testing.assert_allclose(best.pose, 0.0, atol=FIELD_CELL)
    assert 0.3 < best.known < 0.8
