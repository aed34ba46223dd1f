"""The published map has one wall along each stretch, even if the estimate has several landmarks there."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from slam.geometry.segments import Floats
from slam.mapping.landmarks import Landmarks
from slam.mapping.overlap_suppression import MAX_DEPTH, suppress_overlapping_walls
from slam.mapping.wall_cells import END_ERROR_CELLS, WALL_CELL


def landmarks_of(*walls: tuple[list[float], float, int]) -> Landmarks:
    """Return confirmed walls, each with a frame, half length, and number of observations."""
    landmarks = Landmarks()
    for frame, half_length, observations in walls:
        wall = landmarks.add_wall(np.array(frame), half_length, 0)
        landmarks.walls.rows["in_graph"][wall] = True
        landmarks.walls.rows["observations"][wall] = observations
    return landmarks


def shown_pieces(landmarks: Landmarks) -> dict[int, Floats]:
    """Return the pieces of the walls on the published map."""
    shown = suppress_overlapping_walls(landmarks)
    return {int(wall): shown.pieces(int(wall)) for wall in np.flatnonzero(shown.active())}


def test_of_two_overlapping_walls_the_one_with_more_observations_remains() -> None:
    pieces = shown_pieces(landmarks_of(([0.5, 0.03, 0.01], 1.0, 2), ([0.0, 0.0, 0.0], 2.0, 9)))
    assert list(pieces) == [1]
    np.testing.assert_allclose(pieces[1], [[-2.0, 2.0]])


def test_the_part_beyond_the_overlap_remains() -> None:
    pieces = shown_pieces(landmarks_of(([0.0, 0.0, 0.0], 2.0, 9), ([2.0, 0.03, 0.0], 2.0, 2)))
    np.testing.assert_allclose(pieces[0], [[-2.0, 2.0]])
    assert pieces[1][0] == pytest.approx([0.0, 2.0], abs=2 * WALL_CELL)  # along the second, whose frame is at 2


@pytest.mark.parametrize(
    "other",
    [
        [0.0, 0.04, np.pi],  # the other face of a thin wall
        [0.0, MAX_DEPTH + 0.02, 0.0],  # a bay
        [0.0, 0.0, np.pi / 2],  # perpendicular
        [4.5, 0.02, 0.0],  # farther along
    ],
)
def test_other_walls_remain(other: list[float]) -> None:
    landmarks = landmarks_of(([0.0, 0.0, 0.0], 2.0, 9), (other, 2.0, 2))
    pieces = shown_pieces(landmarks)
    assert {wall: p.tolist() for wall, p in pieces.items()} == {w: landmarks.pieces(w).tolist() for w in (0, 1)}


def test_walls_that_meet_at_an_obtuse_angle_end_near_the_intersection() -> None:
    turn = np.radians(8.0)
    bent = [2.0 + 1.5 * np.cos(turn), 1.5 * np.sin(turn), turn]
    pieces = shown_pieces(landmarks_of(([0.0, 0.0, 0.0], 2.4, 9), (bent, 1.5, 5)))
    np.testing.assert_allclose(pieces[0], [[-2.4, 2.4]])
    assert pieces[1][0] == pytest.approx([-1.5 + 0.4, 1.5], abs=2 * WALL_CELL)


def test_unconfirmed_and_removed_walls_suppress_nothing() -> None:
    landmarks = landmarks_of(([0.0, 0.0, 0.0], 2.0, 9), ([0.0, 0.01, 0.0], 2.0, 8), ([0.0, 0.02, 0.0], 1.0, 2))
    landmarks.remove_wall(0, 5)
    landmarks.walls.rows["in_graph"][1] = False
    shown = suppress_overlapping_walls(landmarks)
    assert shown.covered == landmarks.covered


def test_a_fully_overlapped_wall_is_merged_on_the_copy_only() -> None:
    landmarks = landmarks_of(
        ([0.0, 0.0, 0.0], 2.0, 9),
        ([0.0, 0.03, 0.0], 1.0, 5),
        ([0.0, 0.04, 0.0], 0.8, 2),
        ([2.0, 1.0, np.pi / 2], 1.0, 9),
    )
    landmarks.walls.rows["merged_into"][2] = 1  # merged before
    shown = suppress_overlapping_walls(landmarks)
    assert shown.walls.rows["merged_into"].tolist() == [0, 0, 0, 3]
    assert landmarks.walls.rows["merged_into"].tolist() == [0, 1, 1, 3]  # the estimate is unchanged


@given(
    walls=st.lists(
        st.tuples(
            st.floats(-3, 3), st.floats(-0.1, 0.1), st.floats(-0.08, 0.08), st.floats(0.2, 2.5), st.integers(2, 50)
        ),
        min_size=1,
        max_size=8,
    )
)
def test_no_stretch_appears_twice_and_none_is_lost(walls: list[tuple[float, float, float, float, int]]) -> None:
    landmarks = landmarks_of(*(([x, y, turn], half, seen) for x, y, turn, half, seen in walls))
    shown = suppress_overlapping_walls(landmarks)
    before, after = heights(landmarks), heights(shown)
    nothing = np.isnan(after).all(axis=0) & ~np.isnan(before).all(axis=0)
    assert longest(nothing) <= END_ERROR_CELLS + 2
    for wall, other in combinations(after, 2):
        assert longest(np.abs(wall - other) < 0.9 * MAX_DEPTH) <= END_ERROR_CELLS + 2


def heights(landmarks: Landmarks) -> Floats:
    """Return (n, p) the y of each wall at positions x every WALL_CELL, NaN where it is not covered."""
    at = np.arange(-6.0, 6.0, WALL_CELL)
    rows = landmarks.walls.rows
    found = np.full((len(rows), len(at)), np.nan)
    for wall in np.flatnonzero(landmarks.active()).tolist():
        x, y, turn = rows["frame"][wall]
        seen = np.array([landmarks.is_covered(wall, along) for along in (at - x) / np.cos(turn)])
        found[wall, seen] = y + (at[seen] - x) * np.tan(turn)
    return found


def longest(flags: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of True."""
    return max((len(run) for run in "".join("x" if flag else " " for flag in flags).split()), default=0)
