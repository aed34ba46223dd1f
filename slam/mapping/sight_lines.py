"""Sight lines from the robot to the points of a scan: which cells of the walls they hit, and which they cross.

A sight line to a point shows that nothing stands in between. A cell that it crosses is seen through, if both ends are
far enough from the wall, the crossing is steep enough, and both neighbouring sight lines cross the wall's line as well.
A beam that an edge splits (a mixed pixel) measures a range between those of two surfaces: it seems to pass through the
nearer one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled, inlined
from drivers.immutable import immutable
from drivers.small_matrices import quadratic_form
from features.normal_limits import NORMAL_LIMIT

from ..geometry.segments import Floats, Integers
from .landmarks import Landmarks
from .near_landmarks import is_beyond_reach
from .wall_cells import END_ERROR_CELLS, ON_WALL_DISTANCE, WALL_CELL

# Metres from a wall's line, on either side, that both ends of a sight line must be away for the wall to be seen
# through: anything nearer may be the wall itself, or something on it. Origin: chosen, twice the distance of points on
# the wall; not measured.
MIN_DEPTH = 2.0 * ON_WALL_DISTANCE
# Least sine of the angle between a sight line and a wall that it crosses: about 45 degrees. Glass reflects a beam only
# at steep angles, so others would see through it. Origin: chosen; not measured.
MIN_CROSSING_SINE = 0.7


@immutable
class WallsInView:
    """The n active walls within reach of a scan, and what its sight lines show of their cells.

    walls   (n,) landmark ids
    rows    (n,) their rows in the table of walls
    first   (n,) index of the first cell of each wall
    ends    (n + 1,) the cells of wall k are ends[k] to ends[k + 1] in the flat arrays
    seen    flat, True if a point lies on the cell
    depth   flat, metres, see `trace_sight_lines`
    length  (n,) metres of each wall on which points lie
    """

    walls: Integers
    rows: NDArray[np.void]
    first: Integers
    ends: Integers
    seen: NDArray[np.bool_]
    depth: Floats
    length: Floats

    def cells(self, row: int, chosen: NDArray[np.bool_]) -> Integers:
        """Return the cells of a wall that are True in a flat array."""
        return np.asarray(self.first[row] + chosen[self.ends[row] : self.ends[row + 1]].nonzero()[0])


def walls_in_view(landmarks: Landmarks, pose: se2.Pose, points: Floats) -> WallsInView:
    """Trace the sight lines of a scan with points (p, 2), in the frame of its pose, through the walls around it.

    Walls count from either side.
    """
    all_rows = landmarks.walls.rows
    reach = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0))
    walls = _within_reach(all_rows, pose, reach).nonzero()[0]
    rows = all_rows[walls]
    active = landmarks.active(walls) & landmarks.parts.connected(rows["last_seen"])
    walls, rows = walls[active], rows[active]
    first = np.floor(rows["low"] / WALL_CELL).astype(np.int64)
    sizes = np.ceil(rows["high"] / WALL_CELL).astype(np.int64) - first
    ends = np.concatenate([[0], np.cumsum(sizes)])
    return WallsInView(walls, rows, first, ends, *trace_sight_lines(pose, points, rows["frame"].copy(), first, ends))


@compiled
def _within_reach(walls, pose, reach):  # type: ignore[no-untyped-def]
    """Return (n,) which rows of the table of walls have a part within `reach` metres of a pose."""
    within = np.zeros(len(walls), dtype=np.bool_)
    for k in range(len(walls)):
        frame, low, high = walls[k].frame, walls[k].low, walls[k].high
        dx, dy = pose[0] - frame[0], pose[1] - frame[1]
        if is_beyond_reach(dx, dy, low, high, reach):
            continue
        c, s = math.cos(frame[2]), math.sin(frame[2])
        along, across = c * dx + s * dy, c * dy - s * dx
        beyond = max(0.0, low - along, along - high)
        within[k] = beyond * beyond + across * across < reach * reach
    return within


@compiled
def trace_sight_lines(pose, points, frames, first, ends):  # type: ignore[no-untyped-def]
    """Trace sight lines from a pose to points (p, 2), in its frame, through walls with frames (n, 3).

    The points are in the order of the beams. `first` (n,) and `ends` (n + 1,) as in `WallsInView`. Returned are the
    arrays

    seen    flat, True if a point lies on the cell
    depth   flat, metres: of all steep sight lines that cross the cell, the largest distance of the nearer of their two
            ends from the wall's line; 0 without one, and for seen cells
    length  (n,) metres of each wall on which points lie
    """
    seen, depth, length = np.zeros(ends[-1], dtype=np.bool_), np.zeros(ends[-1]), np.zeros(len(frames))
    across = np.zeros(len(points))
    for wall in range(len(frames)):
        c, s = math.cos(frames[wall, 2]), math.sin(frames[wall, 2])
        dx, dy = pose[0] - frames[wall, 0], pose[1] - frames[wall, 1]
        ex, ey = c * dx + s * dy, c * dy - s * dx  # viewpoint in the wall's frame
        c, s = math.cos(pose[2] - frames[wall, 2]), math.sin(pose[2] - frames[wall, 2])
        start, size = ends[wall], ends[wall + 1] - ends[wall]
        side, other_side = math.copysign(1.0, ey), 0
        for p in range(len(points)):
            across[p] = ey + s * points[p, 0] + c * points[p, 1]
            other_side += side * across[p] < ON_WALL_DISTANCE
        if not other_side:  # as for most walls: all points are on this side of its line
            continue
        for p in range(len(points)):
            on_wall = abs(across[p]) < ON_WALL_DISTANCE
            if not on_wall and not _three_cross(across, p, ey):
                continue
            run, rise = c * points[p, 0] - s * points[p, 1], across[p] - ey
            cell = math.floor((ex + (run if on_wall else run * (-ey / rise))) / WALL_CELL) - first[wall]
            if not 0 <= cell < size:  # as of most: whether a sight line is steep takes longer to compute
                continue
            if on_wall:
                seen[start + cell] = True
            elif abs(rise) >= MIN_CROSSING_SINE * math.hypot(run, rise):
                depth[start + cell] = max(depth[start + cell], min(abs(across[p]), abs(ey)))
        for cell in range(start, start + size):
            if seen[cell]:
                depth[cell] = 0.0
                length[wall] += WALL_CELL
    return seen, depth, length


@inlined
def _three_cross(across, p, eye):  # type: ignore[no-untyped-def]
    """Return True if sight line p and both neighbours have both ends more than MIN_DEPTH from a wall, on either side.

    across  (p,) metres of the points from the wall's line
    eye     metres of the viewpoint
    """
    if abs(eye) < MIN_DEPTH:
        return False
    for k in (p, p - 1, p + 1 if p + 1 < len(across) else 0):  # most do not cross themselves
        if eye * across[k] >= 0.0 or abs(across[k]) < MIN_DEPTH:
            return False
    return True


def cells_seen_through(
    view: WallsInView, landmarks: Landmarks, pose: se2.Pose, pose_covariances: Floats
) -> dict[int, list[int]]:
    """Return for each row of `view` the covered cells that are seen through with certainty.

    They are at least END_ERROR_CELLS from an end, and the depth exceeds MIN_DEPTH plus NORMAL_LIMIT standard
    deviations. The variance is that of the wall at its last observation, plus the growth of the pose covariance since
    then; see `local_map_around`.
    """
    through: dict[int, list[int]] = {}
    rows = np.searchsorted(view.ends, view.depth.nonzero()[0], side="right") - 1
    for row in dict.fromkeys(rows.tolist()):
        wall, covered = view.rows[row], landmarks.covered[view.walls[row]]
        known = covered | landmarks.opened_cells(int(view.walls[row]))
        margin = min(END_ERROR_CELLS, (len(covered) - 1) // 4)
        depth = view.depth[view.ends[row] : view.ends[row + 1]]
        drift = pose_covariances[-1] - pose_covariances[wall["last_seen"]]
        deep = _deep_enough(depth, view.first[row], wall["frame"].copy(), wall["covariance"].copy(), pose, drift)
        cells = (view.first[row] + deep.nonzero()[0]).tolist()
        around = range(-margin, margin + 1)
        cells = [cell for cell in cells if cell in covered and known.issuperset(cell + by for by in around)]
        if cells:
            through[row] = cells
    return through


@compiled
def _deep_enough(depth, first, frame, covariance, pose, drift):  # type: ignore[no-untyped-def]
    """Return (k,) which cells of a wall have a sufficient `depth` (k,) for the uncertainty of the wall at that cell.

    covariance  (2, 2) of the wall's offset and heading at its last observation
    drift       (3, 3) growth of the pose covariance since then, in the map's axes
    """
    c, s = math.cos(frame[2]), math.sin(frame[2])
    deep = np.zeros(len(depth), dtype=np.bool_)
    for cell in range(len(depth)):
        if depth[cell] > 0.0:
            along = WALL_CELL * (first + cell + 0.5)
            lever = c * (frame[0] - pose[0]) + s * (frame[1] - pose[1]) + along
            variance = covariance[0, 0] + 2 * along * covariance[0, 1] + along * along * covariance[1, 1]
            variance += max(0.0, quadratic_form(drift, -s, c, lever))
            deep[cell] = depth[cell] > MIN_DEPTH + NORMAL_LIMIT * math.sqrt(variance)
    return deep
