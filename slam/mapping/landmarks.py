"""The walls and corners of the map: extents, observations, merging and removal.

The extent of a wall is kept twice: `low` and `high` are its ends, and the covered cells are the parts in between that
were observed. Cells of a wall that scans have seen through are opened: no longer covered until they are observed again.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers
from .landmark_table import CORNER_DTYPE, DELETED, NEVER_REMOVED, WALL_DTYPE, LandmarkTable
from .map_parts import MapParts
from .near_landmarks import NO_KEYFRAME, near_corners, near_walls
from .wall_cells import (
    WALL_CELL,
    cells_between,
    cells_of,
    latest_openings,
    observed_cells,
    pieces_of,
    still_covered,
    trimmed,
)


class Landmarks:
    """All walls and corners in the map's frame, as the graph last estimated them. Only `slam.mapping` writes to them.

    walls, corners  tables; the row index is the landmark id
    covered         for each wall, the cells of WALL_CELL metres along it that were observed
    opened          for each wall with openings, the opened cells and the keyframe after which each was no longer
                    there; a cell can be covered again by later observations
    parts           parts of the map; a landmark belongs to that of the keyframe that observed it last
    """

    def __init__(self) -> None:
        self.walls = LandmarkTable(WALL_DTYPE)
        self.corners = LandmarkTable(CORNER_DTYPE)
        self.covered: list[frozenset[int]] = []
        self.opened: dict[int, dict[int, int]] = {}
        self.parts = MapParts()

    @classmethod
    def from_tables(
        cls,
        walls: NDArray[np.void],
        corners: NDArray[np.void],
        covered: Sequence[frozenset[int]],
        opened: Mapping[int, Mapping[int, int]],
        parts: MapParts | None = None,
    ) -> Landmarks:
        """Build landmarks from rows of WALL_DTYPE and CORNER_DTYPE, the covered and opened cells, and the parts."""
        landmarks = cls()
        landmarks.walls.replace_rows(walls)
        landmarks.corners.replace_rows(corners)
        landmarks.covered = list(covered)
        landmarks.opened = {wall: dict(cells) for wall, cells in opened.items()}
        landmarks.parts = parts or landmarks.parts
        return landmarks

    def __deepcopy__(self, memo: dict[int, object]) -> Landmarks:
        other = Landmarks()
        other.walls, other.corners = copy.deepcopy(self.walls), copy.deepcopy(self.corners)
        other.covered = list(self.covered)  # the sets are immutable
        other.opened = {wall: dict(cells) for wall, cells in self.opened.items()}
        other.parts = copy.deepcopy(self.parts)
        return other

    # --- observations

    def add_wall(self, frame: se2.Pose, half_length: float, keyframe: int, points: Floats | None = None) -> int:
        """Add a wall first observed by a keyframe, with its `frame` at its centre, and return its id.

        points  see `observe_wall`
        """
        wall = len(self.walls)
        self.covered.append(_covered_by(frame, half_length, 0.0, points))
        return self.walls.append(
            frame=frame,
            low=-half_length,
            high=half_length,
            observations=1,
            first_seen=keyframe,
            last_seen=keyframe,
            merged_into=wall,
            removed_at=NEVER_REMOVED,
        )

    def add_corner(self, position: Floats, headings: Floats, walls: Floats, keyframe: int) -> int:
        """Add a corner first observed by a keyframe and return its id.

        position  (2,) in the map
        headings  (2,) in the map, of the walls before and after it, counter-clockwise as seen
        walls     ids of these walls, -1 if unknown
        """
        return self.corners.append(
            position=position, headings=headings, walls=walls, observations=1, last_seen=keyframe
        )

    def observe_wall(
        self, wall: int, frame: se2.Pose, half_length: float, keyframe: int, points: Floats | None = None
    ) -> None:
        """Record that a keyframe observed a known wall as a segment with its centre at `frame` in the map.

        Extends the wall to the ends of the segment. `points` (p, 2) are those of the scan, in the map: cells are
        covered where they lie closely, and openings are closed only where there are any. None or empty if they are not
        known: all between the ends of the segment is covered.
        """
        row = self.walls.rows[wall]
        along = float(se2.between(row["frame"], frame)[0])
        low, high = along - half_length, along + half_length
        row["low"], row["high"] = min(row["low"], low), max(row["high"], high)
        cells = _covered_by(frame, half_length, along, points)
        if wall in self.opened:  # refinement observes keyframes again: those from before an opening do not close it
            cells = still_covered(cells, self.opened[wall], keyframe)
            cells = self._without_openings(wall, cells, points)
        self.covered[wall] |= cells
        if wall in self.opened:
            self.trim_extent(wall)
        row["first_seen"] = min(row["first_seen"], keyframe)
        if row["last_seen"] != keyframe:
            row["observations"] += 1
            row["last_seen"] = keyframe

    def _without_openings(self, wall: int, cells: frozenset[int], points: Floats | None) -> frozenset[int]:
        """Return some cells of a wall without its openings in which no points (p, 2), in the map, lie."""
        openings = cells & self.opened_cells(wall)
        if points is None or not openings:
            return cells
        in_wall = se2.transform(se2.inverse(self.walls.rows["frame"][wall]), points).reshape(-1, 2)
        return cells - (openings - cells_of(in_wall))

    def observe_corner(self, corner: int, headings: Floats, keyframe: int) -> None:
        """Record that a keyframe observed a known corner."""
        row = self.corners.rows[corner]
        row["headings"] = headings
        row["observations"] += 1
        row["last_seen"] = keyframe

    def restore_walls(self, walls: Iterable[int], keyframes: range) -> list[int]:
        """Treat some walls as never removed or opened at some keyframes; return those that were."""
        removed_at, restored = self.walls.rows["removed_at"], []
        for wall in walls:
            opened = self.opened.get(wall, {})
            kept = {cell: keyframe for cell, keyframe in opened.items() if keyframe not in keyframes}
            if removed_at[wall] in keyframes or kept != opened:
                restored.append(wall)
            if removed_at[wall] in keyframes:
                removed_at[wall] = NEVER_REMOVED
            if kept != opened:
                self.opened[wall] = kept
        return restored

    def set_wall_covariances(self, walls: Integers, covariance: Floats, in_map: Floats | None = None) -> None:
        """Set the covariances (n, 2, 2) of walls (n,) relative to their keyframe `last_seen`, and in the map."""
        rows = self.walls.rows
        rows["covariance"][walls] = covariance
        if in_map is not None:
            rows["covariance_in_map"][walls] = in_map

    def set_corner_covariances(self, corners: Integers, covariance: Floats, in_map: Floats | None = None) -> None:
        """Set the covariances (n, 2, 2) of corners (n,) relative to their keyframe `last_seen`, and in the map."""
        rows = self.corners.rows
        rows["covariance"][corners] = covariance
        if in_map is not None:
            rows["covariance_in_map"][corners] = in_map

    def confirm_observed(self, keyframes: int) -> None:
        """Mark the landmarks that at least so many keyframes observed as confirmed, and no others."""
        for rows in (self.walls.rows, self.corners.rows):
            rows["in_graph"] = rows["observations"] >= keyframes

    def unconfirm_all(self) -> None:
        """Mark all landmarks as not confirmed: none is a variable of a graph yet."""
        for rows in (self.walls.rows, self.corners.rows):
            rows["in_graph"] = False

    # --- merging and removal

    def merge_walls(self, kept: int, absorbed: int) -> None:
        """Merge the wall `absorbed` into the wall `kept`, which gets the extent and the observations of both."""
        walls = self.walls.rows
        walls["merged_into"][walls["merged_into"] == absorbed] = kept
        row, other = walls[kept], walls[absorbed]
        along = se2.between(row["frame"], other["frame"])[0]
        row["low"] = min(row["low"], along + other["low"])
        row["high"] = max(row["high"], along + other["high"])
        self._merge_cells(kept, absorbed, round(along / WALL_CELL))
        row["observations"] += other["observations"]
        row["first_seen"] = min(row["first_seen"], other["first_seen"])
        row["last_seen"] = max(row["last_seen"], other["last_seen"])

    def _merge_cells(self, kept: int, absorbed: int, shift: int) -> None:
        """Merge the covered and opened cells of two walls; cell 0 of `absorbed` is cell `shift` of `kept`.

        A cell that one wall covers stays covered only if that wall was last observed after the other one's cell was
        opened.
        """
        last_seen = self.walls.rows["last_seen"]
        opened = self.opened.get(kept, {})
        also_opened = {cell + shift: keyframe for cell, keyframe in self.opened.get(absorbed, {}).items()}
        shifted = [cell + shift for cell in self.covered[absorbed]]
        own = still_covered(self.covered[kept], also_opened, last_seen[kept])
        self.covered[kept] = own | still_covered(shifted, opened, last_seen[absorbed])
        if opened or also_opened:
            self.opened[kept] = latest_openings(opened, also_opened)

    def move(self, walls: Integers, corners: Integers, motion: se2.Pose) -> None:
        """Move walls (n,) and corners (m,) rigidly by a motion [x, y, heading] in the map."""
        wall_rows, corner_rows = self.walls.rows, self.corners.rows
        wall_rows["frame"][walls] = se2.compose(motion, wall_rows["frame"][walls])
        corner_rows["position"][corners] = se2.transform(motion, corner_rows["position"][corners])
        corner_rows["headings"][corners] = se2.wrap(corner_rows["headings"][corners] + motion[2])

    def remove_wall(self, wall: int, keyframe: int) -> None:
        """Mark a wall as no longer there after a keyframe. Its row is kept."""
        self.walls.rows["removed_at"][wall] = keyframe

    def delete_walls(self, walls: Sequence[int]) -> None:
        """Mark walls as no landmarks, and as deleted by hand. Their rows are kept."""
        self.walls.rows["in_graph"][walls] = False
        self.walls.rows["removed_at"][walls] = DELETED

    def open_wall(self, wall: int, cells: Iterable[int], keyframe: int) -> None:
        """Open cells of a wall: they are no longer there after a keyframe, the rest of the wall is."""
        self.opened.setdefault(wall, {}).update(dict.fromkeys(cells, keyframe))
        self.covered[wall] -= frozenset(cells)
        self.trim_extent(wall)

    def forget_openings(self) -> None:
        """Treat all opened cells as never opened."""
        self.opened = {}

    def trim_extent(self, wall: int) -> None:
        """Move the ends of a wall to within a cell of its outermost covered cells."""
        row, covered = self.walls.rows[wall], self.covered[wall]
        row["low"], row["high"] = trimmed(covered, row["low"], row["high"])

    # --- queries

    def opened_cells(self, wall: int) -> frozenset[int]:
        """Return the opened cells of a wall that have not been observed again."""
        return frozenset(self.opened.get(wall, ())) - self.covered[wall]

    def active(self, walls: NDArray[np.int64] | None = None) -> NDArray[np.bool_]:
        """Return (n,) which walls, of all or of the given ids, are neither merged nor removed."""
        rows, walls = self.walls.rows, np.arange(len(self.walls)) if walls is None else walls
        there = rows["removed_at"][walls] == NEVER_REMOVED
        return np.asarray(there & (rows["merged_into"][walls] == walls))

    def connected(self, *, keyframe: int | None = None) -> NDArray[np.bool_]:
        """Return (n,) which walls are in the part of the map of a keyframe, or in a part joined with it.

        The keyframe is the last one if `keyframe` is None.
        """
        return self.parts.connected(self.walls.rows["last_seen"], keyframe)

    def removed_walls(self) -> NDArray[np.int64]:
        """Return the ids of the confirmed walls that have been removed."""
        walls = self.walls.rows
        return np.flatnonzero(walls["in_graph"] & (walls["removed_at"] != NEVER_REMOVED))

    def deleted_walls(self) -> NDArray[np.int64]:
        """Return the ids of the walls that were deleted by hand."""
        walls = self.walls.rows
        return np.flatnonzero(~walls["in_graph"] & (walls["removed_at"] == DELETED))

    def active_corners(self, corners: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return (m,) which corners have no removed wall among their known walls."""
        walls, of_corners = self.walls.rows, self.corners.rows["walls"][corners]
        if not len(walls):
            return np.ones(len(corners), dtype=bool)
        kept = np.where(of_corners >= 0, walls["merged_into"][of_corners], -1)
        removed_at = np.where(kept >= 0, walls["removed_at"][kept], NEVER_REMOVED)
        return np.asarray((removed_at == NEVER_REMOVED).all(axis=1))

    def is_covered(self, wall: int, along: float) -> bool:
        """Return True if a wall was observed `along` metres from its frame."""
        return math.floor(along / WALL_CELL) in self.covered[wall]

    def pieces(self, wall: int) -> Floats:
        """Return (k, 2) the observed stretches of a wall, begin and end in metres along its frame.

        The outermost ends are `low` and `high`; gaps of up to MIN_GAP_BETWEEN_PIECES metres do not divide a wall.
        """
        return self.pieces_of_walls(np.array([wall]))[0]

    def pieces_of_walls(self, walls: Integers) -> list[Floats]:
        """Return the `pieces` of each of some walls, in a tenth of the time of one after the other."""
        rows = self.walls.rows
        return pieces_of([self.covered[wall] for wall in walls.tolist()], rows["low"][walls], rows["high"][walls])

    def walls_near(self, pose: se2.Pose, radius: float, *, keyframe: int | None = None) -> NDArray[np.int64]:
        """Return the ids of the active walls with a part within `radius` metres of a pose on their visible side.

        With `keyframe`, walls that were removed at that keyframe or later count as active. Only walls that are
        connected with it, see `connected`.
        """
        walls = self.walls.rows
        near = near_walls(walls, pose[0], pose[1], radius, NO_KEYFRAME if keyframe is None else keyframe)
        return self._connected(near, walls["last_seen"], keyframe)

    def corners_near(self, pose: se2.Pose, radius: float, *, keyframe: int | None = None) -> NDArray[np.int64]:
        """Return the ids of the active corners within `radius` metres of a pose; `keyframe` as for walls."""
        corners, walls = self.corners.rows, self.walls.rows
        near = near_corners(corners, walls, pose[0], pose[1], radius, NO_KEYFRAME if keyframe is None else keyframe)
        return self._connected(near, corners["last_seen"], keyframe)

    def _connected(self, near: Integers, last_seen: Integers, keyframe: int | None) -> Integers:
        """Return those of some landmarks that are connected with a keyframe; see `connected`."""
        return near[self.parts.connected(last_seen[near], keyframe)] if len(self.parts) > 1 else near


def _covered_by(frame: se2.Pose, half_length: float, along: float, points: Floats | None) -> frozenset[int]:
    """Return the cells of a wall that a segment covers; arguments as for `observe_wall` and `observed_cells`."""
    if points is None or not len(points):
        return cells_between(along - half_length, along + half_length)
    return observed_cells(frame, half_length, along, points)
