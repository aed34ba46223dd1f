"""Points of a scan that are matched: their spacing, and the normals of their surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import se2
from slam.geometry.segments import Floats, Segments
from slam.matching.scan_points import (
    COLUMNS,
    CONTINUATION,
    FINE_SIGMA,
    LINE_DISTANCE,
    POINT_UNIT,
    ScanPoints,
    segments_of,
    surface_points,
)

from ..outlines import NO_SEGMENTS, outline, visible, with_noise

SPACING = 0.05
SEEDS = st.integers(0, 2**32 - 1)
ROOM = [(0, 0), (5, 0), (5, 2), (3.5, 2), (3.5, 4), (0, 4)]


def wall_points(frame: Floats, length: float) -> Floats:
    """Return points (n, 2) every two centimetres along a wall."""
    along = np.arange(-length / 2, length / 2, 0.02)
    return np.asarray(se2.transform(frame, np.column_stack([along, np.zeros(len(along))])))


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.floats(0.01, 0.5))
def test_points_near_the_one_kept_before_are_left_out(seed: int, spacing: float) -> None:
    steps = np.random.default_rng(seed).normal(0.0, 0.04, (200, 2))
    points = np.cumsum(steps, axis=0)
    kept = surface_points(points, NO_SEGMENTS, spacing)[:, :2]
    assert (np.linalg.norm(np.diff(kept, axis=0), axis=1) >= spacing - 1e-12).all()
    rows = [int(np.flatnonzero((points == point).all(axis=1))[0]) for point in kept]
    assert rows[0] == 0
    assert rows == sorted(rows)
    before = points[np.maximum.accumulate(np.where(np.isin(np.arange(200), rows), np.arange(200), 0))]
    assert (np.linalg.norm(points - before, axis=1) < spacing).all()


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_normals_are_perpendicular_to_a_straight_wall(seed: int) -> None:
    frame = np.random.default_rng(seed).uniform(-5, 5, 3)
    normals = surface_points(wall_points(frame, 3.0), NO_SEGMENTS, SPACING)[:, 2:4]
    assert len(normals) > 40
    np.testing.assert_allclose(np.abs(normals @ [-np.sin(frame[2]), np.cos(frame[2])]), 1.0, atol=1e-9)
    np.testing.assert_allclose(normals @ [np.cos(frame[2]), np.sin(frame[2])], 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_normals_of_a_noisy_wall_are_nearly_perpendicular(seed: int) -> None:
    points = wall_points(np.array([1.0, 2.0, 0.7]), 4.0) + np.random.default_rng(seed).normal(0.0, 0.005, (200, 2))
    normals = surface_points(points, NO_SEGMENTS, SPACING)[:, 2:4]
    assert (np.abs(normals @ [-np.sin(0.7), np.cos(0.7)]) > 0.99).all()


@pytest.mark.parametrize("seed", range(5))
def test_points_on_a_segment_have_its_normal_also_beyond_its_ends(seed: int) -> None:
    random = np.random.default_rng(seed)
    frame, half = random.uniform(-3, 3, 3), 0.5
    segments = Segments(frame[None], np.array([half]), np.zeros((1, 2, 2)))
    points = wall_points(frame, 2 * (CONTINUATION - 0.1) * half) + random.normal(0.0, 0.02, (145, 2))
    normals = surface_points(points, segments, SPACING)[:, 2:4]
    np.testing.assert_array_equal(normals, np.tile([-np.sin(frame[2]), np.cos(frame[2])], (len(normals), 1)))


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_normals_point_to_the_lidar_wherever_it_is_mounted(seed: int) -> None:
    random = np.random.default_rng(seed)
    lidar, mount = random.uniform([0.3, 0.3, -3.0], [3.2, 1.7, 3.0]), random.uniform(-3.0, 3.0, 3)
    points = se2.transform(mount, with_noise(visible(outline(ROOM), lidar), random))
    kept = surface_points(points, NO_SEGMENTS, SPACING)
    on_surface = kept[kept[:, 2:4].any(axis=1)]
    assert len(on_surface) > 100
    np.testing.assert_allclose(np.hypot(*on_surface[:, 2:4].T), 1.0)
    towards = ((mount[:2] - on_surface[:, :2]) * on_surface[:, 2:4]).sum(axis=1)
    assert (towards > -0.05).all()  # up to the noise of walls that are seen from the side
    assert np.mean(towards > 0.2) > 0.9


@pytest.mark.parametrize("mount", [[0.0, 0.0, 0.0], [0.0, 2.0, 1.0]])
def test_normal_of_a_segment_is_that_of_the_side_from_which_it_is_seen(mount: list[float]) -> None:
    frame = np.array([0.0, -1.0, 0.1])  # seen from y > 0 in the lidar's frame; the base may be on the other side
    segments = Segments(se2.compose(np.array(mount), frame)[None], np.array([1.0]), np.zeros((1, 2, 2)))
    points = se2.transform(np.array(mount), wall_points(frame, 2.0))
    normals = surface_points(points, segments, SPACING)[:, 2:4]
    turned = se2.compose(np.array(mount), frame)[2]
    np.testing.assert_allclose(normals, np.tile([-np.sin(turned), np.cos(turned)], (len(normals), 1)), atol=1e-12)


def test_points_belong_to_the_nearest_segment_between_its_ends() -> None:
    frames = np.array([[0.0, 0.0, 0.0], [0.0, 0.06, 0.0], [3.0, 0.0, 0.5 * np.pi]])
    segments = Segments(frames, np.array([1.0, 1.0, 0.5]), np.zeros((3, 2, 2)))
    cases = {
        (0.5, 0.02): 0,
        (-0.9, 0.05): 1,
        (0.5, -0.9 * LINE_DISTANCE): 0,
        (0.5, -1.1 * LINE_DISTANCE): -1,
        (1.05, 0.0): -1,
        (3.05, 0.45): 2,
        (3.0, 0.55): -1,
    }
    points = np.column_stack([np.array(list(cases)), np.zeros((len(cases), 2))])
    assert segments_of(points, segments).tolist() == list(cases.values())
    assert segments_of(points, NO_SEGMENTS).tolist() == [-1] * len(cases)


@pytest.mark.parametrize("seed", range(10))
def test_random_clutter_has_no_normals(seed: int) -> None:
    clutter = np.random.default_rng(seed).uniform(-0.3, 0.3, (60, 2))
    normals = surface_points(clutter, NO_SEGMENTS, SPACING)[:, 2:4]
    assert len(normals) > 40
    assert np.count_nonzero(normals.any(axis=1)) <= 1  # a few points may lie on a line by chance


def test_corners_have_no_normals() -> None:
    points = outline([(0, 0), (3, 0), (3, 2)])
    corner = np.array([3.0, 0.0])
    kept = surface_points(points, NO_SEGMENTS, SPACING)
    apart = np.linalg.norm(kept[:, :2] - corner, axis=1)
    assert not kept[apart < 0.1, 2:4].any()
    assert kept[(apart > 0.5) & (kept[:, 1] < 1e-9) & (kept[:, 0] > 0.5), 3].all()


def test_single_points_have_no_normals() -> None:
    assert surface_points(np.zeros((0, 2)), NO_SEGMENTS, SPACING).shape == (0, COLUMNS)
    alone = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [6.0, 0.0], [8.0, 0.0]])
    np.testing.assert_array_equal(surface_points(alone, NO_SEGMENTS, SPACING)[:, 2:4], 0.0)


def test_the_excess_of_single_points_is_the_more_the_farther_the_beams_are_apart() -> None:
    """Objects are met by beams in pairs: the pairs are metres apart, so that no line is fitted."""
    gaps = np.array([0.001, np.sqrt(12.0) * FINE_SIGMA, 1.0])
    firsts = np.column_stack([3.0 * np.arange(3), np.zeros(3)])
    pairs = np.stack([firsts, firsts + np.column_stack([np.zeros(3), gaps])], axis=1).reshape(-1, 2)
    kept = surface_points(pairs, NO_SEGMENTS, 0.0)
    assert not kept[:, 2:4].any()
    np.testing.assert_allclose(kept[::2, 4], [0.0, 0.5, 1.0], atol=0.02)
    np.testing.assert_array_equal(kept[::2, 4], kept[1::2, 4])


def test_noise_is_no_structure_in_a_scan_without_segments() -> None:
    """A round hall, seen by a dense and noisy lidar: noise may hide the normal of its wall, and shows nothing else."""
    angles = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    noise, unexplained = 0.02, {}
    ranges = 3.0 + noise * np.random.default_rng(1).normal(size=400)
    points = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
    for sigma in (0.0, noise):
        kept = surface_points(points, NO_SEGMENTS, SPACING, sigma)
        unexplained[sigma] = float(np.mean(~kept[:, 2:4].any(axis=1) & (kept[:, 4] < 0.5)))
    assert unexplained[noise] < 0.05 < unexplained[0.0]


def test_all_of_the_only_return_of_a_scan_is_excess() -> None:
    """Nothing tells how far the next beam would be; such scans occur where a hall is wider than the lidar's range."""
    kept = surface_points(np.array([[4.0, 1.0]]), NO_SEGMENTS, SPACING)
    np.testing.assert_array_equal(kept, [[4.0, 1.0, 0.0, 0.0, 1.0, 1.0]])


def test_points_of_exact_surfaces_have_no_excess() -> None:
    kept = surface_points(outline(ROOM), NO_SEGMENTS, SPACING)
    straight = np.abs(kept[:, 2:4]).max(axis=1) > 0.999
    assert np.mean(kept[straight, 4] < 1e-9) > 0.95  # the others have neighbours around a corner
    assert kept[straight, 4].max() < 1e-3
    corners = ~kept[:, 2:4].any(axis=1)  # where two surfaces meet, there are enough neighbours, but no line
    assert corners.any()
    np.testing.assert_array_equal(kept[corners, 4], 0.0)


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_the_excess_of_a_noisy_surface_is_the_variance_of_its_normal(noise: float) -> None:
    """One wall is a segment, and shows how much the points scatter; the other one is none."""
    squares, excess, found = list[float](), list[float](), list[float]()
    segment = Segments(np.array([[-2.0, 5.0, np.pi]]), np.array([2.0]), np.zeros((1, 2, 2)))
    for seed in range(20):
        random = np.random.default_rng(seed)
        along = np.arange(-3.0, 3.0, 0.06)
        wall = np.column_stack([4.0 + noise * random.normal(size=100), along])
        known = np.column_stack([-along - 2.0, 5.0 + noise * random.normal(size=100)])
        kept = surface_points(np.concatenate([wall, known]), segment, SPACING)
        kept = kept[(kept[:, 0] > 3.0) & (np.abs(kept[:, 1]) < 2.5)]
        normals = kept[:, 2:4].any(axis=1)
        found.append(float(normals.mean()))
        squares += (kept[normals, 3] ** 2).tolist()
        excess += kept[normals, 4].tolist()
    assert np.mean(found) > 0.9
    assert np.mean(squares) == pytest.approx(np.mean(excess), rel=0.25)


def test_points_are_rounded_to_the_unit_and_clipped() -> None:
    points = np.array([[1.23449, -0.0006], [1e7, -1e7], [0.0, 80.0]])
    kept = ScanPoints(points)
    np.testing.assert_array_equal(kept.xy, POINT_UNIT * np.array([[1234, -1], [2e6, -2e6], [0, 80000]]))
    np.testing.assert_array_equal(ScanPoints(kept.xy).xy, kept.xy)
