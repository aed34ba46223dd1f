"""Tables of walls and corners: the columns, and a growing structured array whose row index is the landmark id."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Value of `removed_at` for a wall that still exists; otherwise the keyframe after which it no longer did.
# Origin: definition.
NEVER_REMOVED = -1
# The same for a wall that was deleted by hand: it never existed. Origin: definition.
DELETED = 0
# Value of `merged_into` for a wall that no keyframe observes any more, and for walls merged into such a wall; also the
# `last_seen` of a landmark whose observations have been reset. Origin: definition.
UNOBSERVED = -1
# Rows for which memory is reserved at first; it doubles as needed. Origin: numerical.
_INITIAL_CAPACITY = 256

# Columns of the table of walls. Origin: definition.
WALL_DTYPE = np.dtype(
    [
        ("frame", float, 3),  # in the map: x along the wall, which is seen from y > 0
        ("low", float),  # metres along x, both ends of the observed extent
        ("high", float),
        ("observations", int),  # number of keyframes that observed it
        ("first_seen", int),  # keyframe
        ("last_seen", int),  # keyframe
        ("covariance", float, (2, 2)),  # of offset and heading at the frame, relative to the keyframe last_seen
        ("covariance_in_map", float, (2, 2)),  # likewise in the map, computed when last_seen was the last keyframe
        ("merged_into", int),  # id of the wall that replaces this one: its own id if it is not merged, or UNOBSERVED
        ("in_graph", bool),  # confirmed, and therefore a variable of the graph
        ("removed_at", int),  # keyframe after which the wall no longer existed, NEVER_REMOVED or DELETED
    ]
)

# Columns of the table of corners. Origin: definition.
CORNER_DTYPE = np.dtype(
    [
        ("position", float, 2),  # in the map
        ("headings", float, 2),  # in the map, of the walls before and after it (counter-clockwise as seen)
        ("walls", int, 2),  # ids of these walls, -1: unknown
        ("observations", int),  # number of keyframes that observed it
        ("last_seen", int),  # keyframe
        ("covariance", float, (2, 2)),  # relative to the keyframe last_seen, in the map's axes
        ("covariance_in_map", float, (2, 2)),  # in the map, computed when last_seen was the last keyframe
        ("in_graph", bool),  # confirmed, and therefore a variable of the graph
    ]
)


class LandmarkTable:
    """Growing table of one structured dtype. A row's index never changes: it is the landmark id.

    Only `slam.mapping` writes to the rows.
    """

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        self._storage = np.zeros(_INITIAL_CAPACITY, dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[np.void]:
        """The rows in use, as a view of the table."""
        return self._storage[: self._count]

    def replace_rows(self, rows: NDArray[np.void]) -> None:
        """Replace all rows."""
        self._storage, self._count = np.zeros(max(_INITIAL_CAPACITY, len(rows)), rows.dtype), len(rows)
        self._storage[: len(rows)] = rows

    def append(self, **fields: Any) -> int:
        """Add a row and return its index; columns that are not given are zero."""
        if self._count == len(self._storage):
            self._storage = np.concatenate([self._storage, np.zeros_like(self._storage)])
        for name, value in fields.items():
            self._storage[name][self._count] = value
        self._count += 1
        return self._count - 1
