"""Distance field: vectors from the nearest points, faces, interpolation and seen cells."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import se2
from slam.geometry.segments import Floats
from slam.matching.distance_field import (
    ALL_POINTS,
    DistanceField,
    facing_grid,
    nearest_distance,
)
from slam.matching.free_space import SEEN_CELL, is_seen
from slam.matching.interpolation import BLOCK, interpolate
from slam.matching.offset_tiles import FIELD_CELL, MAX_DISTANCE, NOWHERE, OFFSET_UNIT

from ..outlines import offsets_of

HALF_WIDTH = 2.0  # metres
SEEDS = st.integers(0, 2**32 - 1)


def centres(origin: Floats, count: int, side: float) -> Floats:
    """Return the centres (count, count, 2) of a grid's cells in the map."""
    axis = (np.arange(count) + 0.5) * side
    return origin + np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)


def distances_to(points: Floats, cells: Floats) -> Floats:
    """Return the distances of cells (c, c, 2) to the nearest of points (p, 2), at most MAX_DISTANCE."""
    apart = np.linalg.norm(cells[:, :, None] - points, axis=-1)
    return np.asarray(np.minimum(apart.min(axis=-1, initial=MAX_DISTANCE), MAX_DISTANCE))


def distances_of(field: DistanceField, grid: int) -> Floats:
    """Return the distances (c, c), metres, that are stored in a grid; MAX_DISTANCE where there is none."""
    offset = offsets_of(field)[grid]
    distances = np.hypot(*np.moveaxis(OFFSET_UNIT * offset, -1, 0))
    return np.asarray(np.where(offset[..., 0] == NOWHERE, MAX_DISTANCE, distances))


def in_cells(field: DistanceField, position: Floats) -> tuple[float, float]:
    """Return a position (2,) in the map in cells of the field."""
    x, y = (position - field.origin) / FIELD_CELL
    return float(x), float(y)


def vectors_at(field: DistanceField, position: Floats, normal: Floats) -> Floats:
    """Return the vector (1, 2) from a surface to a point with a normal, or (0, 2) if none is near; all cells count as
    seen."""
    field = copy.deepcopy(field)
    field.seen[:] = 1
    return np.asarray(interpolate(np.zeros(3), np.array([[*position, *normal]]), field.arrays)[1])


def wall_points(position: Floats, normal: Floats) -> Floats:
    """Return points (100, 2) every two centimetres on a wall through a position."""
    return np.asarray(position + np.arange(-1.0, 1.0, 0.02)[:, None] * np.array([-normal[1], normal[0]]))


def wall_field(position: Floats, normal: Floats, facing: Floats) -> DistanceField:
    """Return the field of points every two centimetres on a wall through a position, with normals `facing` (2,)."""
    points = wall_points(position, normal)
    field = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    field.insert(np.zeros(3), np.column_stack([points, np.tile(facing, (len(points), 1))]))
    return field


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(0, 40), st.sampled_from([2, 4]))
def test_vectors_are_those_from_the_nearest_point_up_to_a_cell(seed: int, count: int, columns: int) -> None:
    random = np.random.default_rng(seed)
    centre, pose = random.uniform(-5, 5, 2), random.uniform(-3, 3, 3)
    field = DistanceField.empty(centre, HALF_WIDTH)
    inside = HALF_WIDTH - MAX_DISTANCE - SEEN_CELL - FIELD_CELL  # points whose surroundings are in the field
    points = centre + random.uniform(-inside, inside, (count, 2))
    local = np.column_stack([se2.transform(se2.inverse(pose), points).reshape(-1, 2), np.zeros((count, 2))])
    field.insert(pose, local[:, :columns])
    cells = centres(field.origin, len(offsets_of(field)[0]), FIELD_CELL)
    expected = distances_to(points, cells)
    for grid in range(ALL_POINTS + 1):  # a point without a normal may face in any direction
        np.testing.assert_allclose(distances_of(field, grid), expected, atol=FIELD_CELL)
        offset = offsets_of(field)[grid]
        stored = offset[..., 0] != NOWHERE
        ends = cells[stored] - OFFSET_UNIT * offset[stored]
        assert (distances_to(points, ends[:, None])[:, 0] < OFFSET_UNIT).all()


def test_scans_add_up() -> None:
    one, other = np.array([[0.3, 0.2]]), np.array([[-0.5, 0.1]])
    field = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    field.insert(np.zeros(3), one)
    field.insert(np.zeros(3), other)
    expected = distances_to(np.concatenate([one, other]), centres(field.origin, len(offsets_of(field)[0]), FIELD_CELL))
    np.testing.assert_allclose(distances_of(field, ALL_POINTS), expected, atol=FIELD_CELL)


def test_scans_inserted_together_are_those_inserted_one_by_one() -> None:
    random = np.random.default_rng(0)
    poses = np.column_stack([random.uniform(-1, 1, (3, 2)), random.uniform(-3, 3, 3)])
    scans = [np.column_stack([random.uniform(-2, 2, (20, 2)), np.zeros((20, 2))]) for _ in poses]
    together, one_by_one = DistanceField.empty(np.zeros(2), HALF_WIDTH), DistanceField.empty(np.zeros(2), HALF_WIDTH)
    together.insert_scans(poses, scans)
    for pose, scan in zip(poses, scans, strict=True):
        one_by_one.insert(pose, scan)
    np.testing.assert_array_equal(offsets_of(together), offsets_of(one_by_one))
    np.testing.assert_array_equal(together.seen, one_by_one.seen)


def test_copy_is_independent() -> None:
    field = wall_field(np.zeros(2), np.array([1.0, 0.0]), np.array([1.0, 0.0]))
    before, seen = offsets_of(field), field.seen.copy()
    copied = copy.deepcopy(field)
    np.testing.assert_array_equal(offsets_of(copied), before)
    copied.insert(np.array([0.5, 0.5, 1.0]), wall_points(np.array([0.7, 0.0]), np.array([0.0, 1.0])))
    assert (offsets_of(copied) != before).any()
    np.testing.assert_array_equal(offsets_of(field), before)
    np.testing.assert_array_equal(field.seen, seen)


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.one_of(st.floats(-np.pi, np.pi), st.sampled_from([0.0, 0.5 * np.pi, np.pi])), st.floats(-0.2, 0.2))
def test_vector_is_linear_across_a_wall(seed: int, heading: float, across: float) -> None:
    random = np.random.default_rng(seed)
    normal, middle = np.array([np.cos(heading), np.sin(heading)]), random.uniform(-0.2, 0.2, 2)
    field = wall_field(middle, normal, normal)
    position = middle + across * normal + random.uniform(-0.5, 0.5) * np.array([-normal[1], normal[0]])
    (vector,) = vectors_at(field, position, normal)
    assert normal @ vector == pytest.approx(across, abs=5e-4)
    assert abs(-normal[1] * vector[0] + normal[0] * vector[1]) < FIELD_CELL
    distance = nearest_distance(field.arrays, facing_grid(*normal), *in_cells(field, position))
    assert distance == pytest.approx(abs(across), abs=FIELD_CELL)


@pytest.mark.parametrize("heading", np.radians([0.0, 20.0, 44.0, 90.0, 180.0, 250.0, 270.0]))
@pytest.mark.parametrize("turn", np.radians([-20.0, 0.0, 20.0]))
def test_faces_of_a_thin_wall_are_told_apart_also_if_the_heading_is_wrong(heading: float, turn: float) -> None:
    normal = np.array([np.cos(heading), np.sin(heading)])
    field = wall_field(np.zeros(2), normal, normal)
    front = np.array([np.cos(heading + turn), np.sin(heading + turn)])
    behind = in_cells(field, -0.1 * normal)
    assert len(vectors_at(field, -0.1 * normal, front))
    assert nearest_distance(field.arrays, facing_grid(*front), *behind) < 0.1 + FIELD_CELL
    assert not len(vectors_at(field, -0.1 * normal, -front))
    assert nearest_distance(field.arrays, facing_grid(*-front), *behind) == MAX_DISTANCE
    field.insert(np.zeros(3), np.column_stack([wall_points(-0.1 * normal, normal), np.tile(-normal, (100, 1))]))
    for facing, face in ((front, 0.0), (-front, -0.1)):
        for across in (-0.12, -0.07, -0.03, 0.02):
            (vector,) = vectors_at(field, across * normal, facing)
            assert normal @ vector == pytest.approx(across - face, abs=5e-4)


def test_surface_without_normal_is_searched_among_all_points() -> None:
    assert facing_grid(0.0, 0.0) == ALL_POINTS
    field = wall_field(np.zeros(2), np.array([1.0, 0.0]), np.array([1.0, 0.0]))
    assert len(vectors_at(field, np.array([0.1, 0.0]), np.zeros(2)))


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_interpolation_between_two_walls_does_not_mix_them(seed: int) -> None:
    random = np.random.default_rng(seed)
    x, y = random.uniform(-0.25, 0.25), random.uniform(-0.5, 0.5)
    field = wall_field(np.array([-0.3, 0.0]), np.array([1.0, 0.0]), np.array([0.0, 0.0]))
    field.insert(np.zeros(3), wall_points(np.array([0.3, 0.0]), np.array([1.0, 0.0])))
    (vector,) = vectors_at(field, np.array([x, y]), np.zeros(2))
    assert min(abs(vector[0] - (x + 0.3)), abs(vector[0] - (x - 0.3))) < 5e-4


@pytest.mark.parametrize(("x", "y"), [(-3.0, 5.0), (5.0, -0.1), (83.0, 5.0), (5.0, 80.0), (5.0, 79.6), (0.4, 5.0)])
def test_nothing_is_found_outside(x: float, y: float) -> None:
    field = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    field.offsets.tile_of[:], field.offsets.tiles[:] = 0, 0
    for place, count in (((x, y), 0), ((5.0, 5.0), 1)):
        assert len(vectors_at(field, field.origin + FIELD_CELL * np.array(place), np.array([1.0, 0.0]))) == count


def test_points_are_matched_in_any_number() -> None:
    """They are computed in blocks; each has the vector that it has alone, and those far from the wall have none."""
    random = np.random.default_rng(0)
    field = wall_field(np.zeros(2), np.array([1.0, 0.0]), np.array([1.0, 0.0]))
    field.seen[:] = 1
    points = np.column_stack([random.uniform(-1.0, 1.0, (3 * BLOCK + 5, 2)), np.tile([1.0, 0.0], (3 * BLOCK + 5, 1))])
    rows, vectors = interpolate(np.zeros(3), points, field.arrays)
    alone = [interpolate(np.zeros(3), points[k : k + 1], field.arrays)[1] for k in range(len(points))]
    assert BLOCK < len(rows) < len(points) - BLOCK
    np.testing.assert_array_equal(rows, np.flatnonzero([len(one) for one in alone]))
    np.testing.assert_array_equal(vectors, np.concatenate(alone))


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_cells_along_a_beam_are_seen_and_no_others(seed: int) -> None:
    random = np.random.default_rng(seed)
    field = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    start, end = random.uniform(-1.7, 1.7, (2, 2))
    pose = np.array([*start, random.uniform(-np.pi, np.pi)])
    field.insert(pose, se2.transform(se2.inverse(pose), end[None]))
    beam = start + np.linspace(0, 1, 500)[:, None] * (end - start)
    seen = centres(field.origin, len(field.seen), SEEN_CELL)[field.seen > 0]
    apart = np.linalg.norm(beam[:, None] - seen, axis=-1)
    assert apart.min(axis=1).max() < SEEN_CELL
    assert apart.min(axis=0).max() < SEEN_CELL * np.sqrt(0.5) + 0.01
    for point in (start, end):
        assert is_seen(field.seen, *((point - field.origin) / FIELD_CELL))
    assert not is_seen(field.seen, -1.0, 5.0)
    assert not is_seen(field.seen, 1e4, 5.0)


@pytest.mark.parametrize("point", [[50.0, 0.0], [0.0, -50.0], [-2.5, 2.5], [-50.0, -50.0]])
def test_points_outside_are_ignored_but_the_beams_to_them_are_seen(point: list[float]) -> None:
    field = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    field.insert(np.zeros(3), np.array([point]))
    assert (offsets_of(field) == NOWHERE).all()
    inside = np.array(point) / np.abs(point).max() * (HALF_WIDTH - 0.5 * SEEN_CELL)
    assert is_seen(field.seen, *((inside - field.origin) / FIELD_CELL))


def test_distance_from_the_middle_is_the_larger_one_along_the_axes() -> None:
    field = DistanceField.empty(np.array([3.0, -2.0]), HALF_WIDTH)
    assert field.centre_distance(np.array([3.0, -2.0])) < SEEN_CELL
    assert field.centre_distance(np.array([3.5, 3.0])) == pytest.approx(5.0, abs=SEEN_CELL)


def test_a_cleared_field_is_like_a_new_one() -> None:
    random = np.random.default_rng(0)
    points, centre = random.uniform(-1.5, 1.5, (2, 500, 2)), np.array([0.7, -0.4])
    used = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    used.insert(np.zeros(3), points[0])
    cleared, new = used.cleared(centre), DistanceField.empty(centre, HALF_WIDTH)
    for field in (cleared, new):
        field.insert(np.zeros(3), points[1])
    np.testing.assert_array_equal(cleared.origin, new.origin)
    np.testing.assert_array_equal(cleared.seen, new.seen)
    np.testing.assert_array_equal(offsets_of(cleared), offsets_of(new))


def test_a_completed_field_has_the_same_values_in_less_memory() -> None:
    field = DistanceField.empty(np.zeros(2), HALF_WIDTH)
    field.insert(np.zeros(3), wall_points(np.array([1.0, 0.2]), np.array([-1.0, 0.0])))
    offsets, seen, room = offsets_of(field), field.seen.copy(), len(field.offsets.tiles)
    completed = field.completed()
    assert np.array_equal(offsets_of(completed), offsets)
    assert np.array_equal(completed.seen, seen)
    assert len(completed.offsets.tiles) == completed.offsets.count < room
    assert completed.waiting.cells.nbytes == 0
