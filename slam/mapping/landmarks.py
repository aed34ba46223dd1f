"""The walls and corners known so far."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats

BEHIND_MARGIN = 0.5  # metres the robot may stand behind a wall's line and still be about to see it: drift, and far ends
CELL = 0.1  # metres of wall whose having been seen is remembered together
OPENING = 0.5  # metres of a wall never seen between two stretches that were: a door, a passage
NEVER_REMOVED = -1  # stands for the keyframe after which a wall was no longer there, where it still is

WALL = np.dtype(
    [
        ("frame", float, 3),  # in the map: x along the wall, which is seen from y > 0
        ("low", float),  # metres along x, how far the wall is known
        ("high", float),
        ("observations", int),  # keyframes
        ("first_seen", int),  # keyframe
        ("last_seen", int),
        ("covariance", float, (2, 2)),  # of offset and heading at the frame, as seen from the keyframe last_seen
        ("covariance_in_map", float, (2, 2)),  # the same in the map, as it was when last_seen was the last keyframe
        ("merged_into", int),  # the wall that speaks for this one: itself, or the wall that it turned out to be
        ("in_graph", bool),
        ("removed_at", int),  # the keyframe after which it was no longer there, STANDING where it is
    ]
)

CORNER = np.dtype(
    [
        ("position", float, 2),  # in the map
        ("headings", float, 2),  # in the map, of the walls before and after it (counter-clockwise as seen)
        ("walls", int, 2),  # their indices, -1 where not known
        ("observations", int),
        ("last_seen", int),
        ("covariance", float, (2, 2)),  # as seen from the keyframe last_seen, in the map's axes
        ("covariance_in_map", float, (2, 2)),  # in the map, as it was when last_seen was the last keyframe
        ("in_graph", bool),
    ]
)


class Table:
    """Rows of one structured type, growing; an index is an identity for good."""

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        self._storage = np.zeros(256, dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[np.void]:
        """The rows in use, as a view: assigning to it writes."""
        return self._storage[: self._count]

    def fill(self, rows: NDArray[np.void]) -> None:
        """TrackingStatus these rows and no others."""
        self._storage, self._count = np.zeros(max(256, len(rows)), rows.dtype), len(rows)
        self._storage[: len(rows)] = rows

    def append(self, **fields: Any) -> int:
        """Add a row; returns its index."""
        if self._count == len(self._storage):
            self._storage = np.concatenate([self._storage, np.zeros_like(self._storage)])
        for name, value in fields.items():
            self._storage[name][self._count] = value
        self._count += 1
        return self._count - 1


class Landmarks:
    """All walls and corners, in the map's frame, as the graph last estimated them."""

    def __init__(self) -> None:
        self.walls = Table(WALL)
        self.corners = Table(CORNER)
        # of each wall, the cells of CELL metres along it where it was seen
        self.covered: list[frozenset[int]] = []
        # of walls that have been opened, the cells that were no longer there after a keyframe; they may be again
        self.opened: dict[int, dict[int, int]] = {}

    def __deepcopy__(self, memo: dict[int, object]) -> Landmarks:
        other = Landmarks()
        other.walls, other.corners = copy.deepcopy(self.walls), copy.deepcopy(self.corners)
        other.covered = list(self.covered)  # of what never changes
        other.opened = {wall: dict(cells) for wall, cells in self.opened.items()}
        return other

    def add_wall(self, frame: se2.Pose, half_length: float, keyframe: int) -> int:
        """A wall first seen from a keyframe, its `frame` at its centre. Returns its identity."""
        identity = len(self.walls)
        self.covered.append(_cells(-half_length, half_length))
        return self.walls.append(
            frame=frame,
            low=-half_length,
            high=half_length,
            observations=1,
            first_seen=keyframe,
            last_seen=keyframe,
            merged_into=identity,
            removed_at=NEVER_REMOVED,
        )

    def add_corner(self, position: Floats, headings: Floats, walls: Floats, keyframe: int) -> int:
        """A corner first seen from a keyframe. Returns its identity."""
        return self.corners.append(
            position=position, headings=headings, walls=walls, observations=1, last_seen=keyframe
        )

    def see_wall(self, wall: int, frame: se2.Pose, half_length: float, keyframe: int) -> None:
        """A known wall seen again, as a segment with its centre at `frame` in the map; it may reach further now."""
        row = self.walls.rows[wall]
        along = se2.between(row["frame"], frame)[0]
        row["low"] = min(row["low"], along - half_length)
        row["high"] = max(row["high"], along + half_length)
        cells = _cells(along - half_length, along + half_length)
        if wall in self.opened:  # when all is looked at again, what was seen before a stretch was opened is seen anew
            opened = self.opened[wall]
            cells = frozenset(cell for cell in cells if opened.get(cell, NEVER_REMOVED) < keyframe)
        self.covered[wall] |= cells
        if row["last_seen"] != keyframe:
            row["observations"] += 1
            row["last_seen"] = keyframe

    def see_corner(self, corner: int, headings: Floats, keyframe: int) -> None:
        """A known corner seen again."""
        row = self.corners.rows[corner]
        row["headings"] = headings
        row["observations"] += 1
        row["last_seen"] = keyframe

    def absorb(self, kept: int, absorbed: int) -> None:
        """The wall `absorbed` is the wall `kept`: it speaks for both, over the extent of both."""
        walls = self.walls.rows
        walls["merged_into"][walls["merged_into"] == absorbed] = kept
        row, other = walls[kept], walls[absorbed]
        along = se2.between(row["frame"], other["frame"])[0]
        row["low"] = min(row["low"], along + other["low"])
        row["high"] = max(row["high"], along + other["high"])
        shift = round(along / CELL)
        opened, also = self.opened.get(kept, {}), self.opened.get(absorbed, {})
        also = {cell + shift: keyframe for cell, keyframe in also.items()}
        shifted = [cell + shift for cell in self.covered[absorbed]]
        # either may have been opened after the other was seen last
        own = {cell for cell in self.covered[kept] if also.get(cell, NEVER_REMOVED) < row["last_seen"]}
        self.covered[kept] = frozenset(
            own | {cell for cell in shifted if opened.get(cell, NEVER_REMOVED) < other["last_seen"]}
        )
        if opened or also:
            both = opened.keys() | also.keys()
            self.opened[kept] = {
                cell: max(opened.get(cell, NEVER_REMOVED), also.get(cell, NEVER_REMOVED)) for cell in both
            }
        row["observations"] += other["observations"]
        row["first_seen"] = min(row["first_seen"], other["first_seen"])
        row["last_seen"] = max(row["last_seen"], other["last_seen"])

    def remove_wall(self, wall: int, keyframe: int) -> None:
        """A wall is no longer there after a keyframe. What is known of it is kept."""
        self.walls.rows["removed_at"][wall] = keyframe

    def open(self, wall: int, cells: Iterable[int], keyframe: int) -> None:
        """Some cells of a wall are no longer there after a keyframe, though the rest of it is."""
        self.opened.setdefault(wall, {}).update(dict.fromkeys(cells, keyframe))
        self.covered[wall] -= frozenset(cells)
        self.shorten(wall)

    def opened_cells(self, wall: int) -> frozenset[int]:
        """The cells of a wall that were seen once and are no longer there."""
        return frozenset(self.opened.get(wall, ())) - self.covered[wall]

    def shorten(self, wall: int) -> None:
        """Let a wall end where what is left of it does."""
        row, covered = self.walls.rows[wall], self.covered[wall]
        if covered:
            row["low"] = max(row["low"], CELL * (min(covered) - 1))
            row["high"] = min(row["high"], CELL * (max(covered) + 2))

    def active(self, walls: NDArray[np.int64] | None = None, *, keyframe: int | None = None) -> NDArray[np.bool_]:
        """(n,): which walls, of all or of some, speak for themselves and are still there, or were after a keyframe."""
        rows, walls = self.walls.rows, np.arange(len(self.walls)) if walls is None else walls
        removed_at = rows["removed_at"][walls]
        there = removed_at == NEVER_REMOVED
        if keyframe is not None:
            there |= removed_at >= keyframe
        return np.asarray(there & (rows["merged_into"][walls] == walls))

    def removed_walls(self) -> NDArray[np.int64]:
        """Identities of the confirmed walls that are no longer there."""
        walls = self.walls.rows
        return np.flatnonzero(walls["in_graph"] & (walls["removed_at"] != NEVER_REMOVED))

    def active_corners(self, corners: NDArray[np.int64], keyframe: int | None = None) -> NDArray[np.bool_]:
        """(m,): whether the walls of some corners (m,), as far as they are known, are still there, or were."""
        walls, named = self.walls.rows, self.corners.rows["walls"][corners]
        if not len(walls):
            return np.ones(len(corners), dtype=bool)
        kept = np.where(named >= 0, walls["merged_into"][named], -1)
        removed_at = np.where(kept >= 0, walls["removed_at"][kept], NEVER_REMOVED)
        gone = removed_at != NEVER_REMOVED
        if keyframe is not None:
            gone &= removed_at < keyframe
        return np.asarray(~gone.any(axis=1))

    def is_covered(self, wall: int, along: float) -> bool:
        """Whether a wall was seen at a place `along` metres from its frame: between its ends there may be doors."""
        return math.floor(along / CELL) in self.covered[wall]

    def pieces(self, wall: int) -> Floats:
        """(k, 2): the stretches of a wall that were seen, from and to, metres from its frame; `low` and `high` are the
        outermost ends."""
        row = self.walls.rows[wall]
        cells = np.sort(np.fromiter(self.covered[wall], dtype=np.int64, count=len(self.covered[wall])))
        breaks = np.flatnonzero(np.diff(cells) > OPENING / CELL)
        begin = np.concatenate([[row["low"]], CELL * cells[breaks + 1]])
        end = np.concatenate([CELL * (cells[breaks] + 1), [row["high"]]])
        return np.column_stack([begin, end])

    def walls_near(self, pose: se2.Pose, radius: float, *, keyframe: int | None = None) -> NDArray[np.int64]:
        """Identities of the walls with a part within `radius` (metres) of the pose that may be seen from there, and
        that are still there, or were after a `keyframe`."""
        walls = self.walls.rows
        if not len(walls):
            return np.zeros(0, dtype=np.int64)
        seen = se2.transform(se2.inverse(walls["frame"]), pose[:2])
        beyond = np.maximum(0.0, np.maximum(walls["low"] - seen[:, 0], seen[:, 0] - walls["high"]))
        near = np.flatnonzero((np.hypot(beyond, seen[:, 1]) < radius) & (seen[:, 1] > -BEHIND_MARGIN))
        return near[self.active(near, keyframe=keyframe)]

    def corners_near(self, pose: se2.Pose, radius: float, *, keyframe: int | None = None) -> NDArray[np.int64]:
        """Identities of the corners within `radius` (metres) of the pose, of walls as above."""
        offset = self.corners.rows["position"] - pose[:2]
        near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < radius)
        return near[self.active_corners(near, keyframe)]


def _cells(low: float, high: float) -> frozenset[int]:
    """The cells that lie wholly between two places along a wall."""
    return frozenset(range(math.ceil(low / CELL), math.floor(high / CELL)))
