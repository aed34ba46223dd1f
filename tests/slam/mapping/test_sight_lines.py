"""Sight lines of a scan through a wall: seen cells, and the depth of cells that are seen through."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import se2
from slam.mapping.sight_lines import MIN_CROSSING_SINE, MIN_DEPTH, trace_sight_lines
from slam.mapping.wall_cells import ON_WALL_DISTANCE, WALL_CELL


@settings(deadline=None)
@given(
    frame=st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-np.pi, np.pi)),
    heading=st.floats(-np.pi, np.pi),
    cell=st.integers(-9, 9),
    sine=st.floats(MIN_CROSSING_SINE + 0.01, 1.0),
    backwards=st.booleans(),
    before=st.floats(MIN_DEPTH + 0.01, 8.0),
    behind=st.floats(MIN_DEPTH + 0.01, 8.0),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_a_steep_sight_line_crosses_one_cell_at_the_depth_of_its_nearer_end(
    frame: Sequence[float],
    heading: float,
    cell: int,
    sine: float,
    backwards: bool,
    before: float,
    behind: float,
    side: float,
) -> None:
    """For any pose of wall and robot, from either side."""
    along = WALL_CELL * (cell + 0.5)
    slope = np.sqrt(1.0 - sine**2) / sine * (-1.0 if backwards else 1.0)
    viewpoint, point = [along - slope * before, side * before], [along + slope * behind, -side * behind]
    seen, depth, length = trace(frame, heading, viewpoint, [point])
    assert not seen.any()
    assert length == 0.0
    assert np.flatnonzero(depth).tolist() == [cell + 10]
    assert depth[cell + 10] == pytest.approx(min(before, behind))
    on_wall = [along, 0.9 * ON_WALL_DISTANCE]
    seen, depth, length = trace(frame, heading, viewpoint, [point, on_wall])  # a seen cell is not seen through
    assert np.flatnonzero(seen).tolist() == [cell + 10]
    assert not depth.any()
    assert length == pytest.approx(WALL_CELL)


@pytest.mark.parametrize(
    ("viewpoint", "point"),
    [
        ([0.05, 2.0], [0.05, 0.5]),  # ends in front of the wall
        ([0.05, 2.0], [0.05, -0.9 * MIN_DEPTH]),  # too close behind it
        ([0.05, 0.9 * MIN_DEPTH], [0.05, -2.0]),  # the robot is too close to it
        ([-4.0, 2.0], [4.1, -2.0]),  # at a grazing angle
        ([1.15, 2.0], [1.15, -2.0]),  # passes beside it
    ],
)
def test_sight_lines_that_do_not_count(viewpoint: Sequence[float], point: Sequence[float]) -> None:
    seen, depth, _ = trace([3.0, -2.0, 0.7], 0.3, viewpoint, [point])
    assert not seen.any()
    assert not depth.any()


def test_a_beam_that_an_edge_splits_does_not_see_through_the_wall() -> None:
    """Its range lies between that of the wall, which the next beam hits, and that of the background."""
    beside, split, hit = [1.2, -3.0], [0.85, -1.0], [0.75, 0.0]
    _, depth, _ = trace([3.0, -2.0, 0.7], 0.3, [0.0, 2.0], [hit, split, beside])
    assert not depth.any()


def test_three_beams_in_a_row_see_through_a_wall() -> None:
    _, depth, _ = trace([3.0, -2.0, 0.7], 0.3, [0.0, 2.0], [[0.2, -1.0], [0.0, -1.0], [-0.2, -1.0]])
    assert depth.any()


def trace(
    frame: Sequence[float], heading: float, viewpoint: Sequence[float], points: Sequence[Sequence[float]]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Trace sight lines through a wall from -1 m to 1 m, given the viewpoint and points in the wall's frame."""
    pose = se2.compose(np.array(frame), np.array([*viewpoint, heading]))
    in_base = se2.transform(se2.inverse(np.array([*viewpoint, heading])), np.array(points)).reshape(-1, 2)
    seen, depth, length = trace_sight_lines(pose, in_base, np.array([frame]), np.array([-10]), np.array([0, 20]))
    return seen, depth, float(length[0])
