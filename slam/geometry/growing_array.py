"""Array to which rows are appended without copying it each time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .segments import Floats

# Rows for which memory is reserved with the first one that is appended. Origin: numerical.
_INITIAL_CAPACITY = 64
# Share of the rows for which more memory is reserved when it is used up. All are copied then, each some eight times in
# the end. Origin: numerical.
_RESERVE = 1 / 8


class GrowingArray:
    """Rows of floats, all of one shape; () for numbers. A change leaves the rows that were read before as they were."""

    def __init__(self, shape: Sequence[int], rows: ArrayLike = ()) -> None:
        """Create an array with rows of a shape."""
        self._shape = tuple(shape)
        self._shared = 0  # rows at the beginning that a copy may have in common with this array
        self.replace(rows)

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> Floats:
        """(n, ...) the rows; not to be changed."""
        return self._storage[: self._count]

    def copy(self) -> GrowingArray:
        """Return a copy that later changes leave as it is. It shares the present rows until either replaces some."""
        other = GrowingArray(self._shape)
        other._storage, other._count = self.rows, self._count
        self._shared = other._shared = self._count
        return other

    def replace(self, rows: ArrayLike) -> None:
        """Replace all rows by (n, ...) others, which are copied."""
        self._storage: Floats = np.array(rows, dtype=np.float64, order="C").reshape(-1, *self._shape)
        self._count, self._shared = len(self._storage), 0

    def replace_last(self, rows: ArrayLike) -> None:
        """Replace the last rows by (m, ...) others."""
        new = np.asarray(rows, dtype=np.float64).reshape(-1, *self._shape)
        self._move(len(self._storage))
        self._storage[self._count - len(new) : self._count] = new

    def overwrite_last(self, row: ArrayLike) -> None:
        """Replace the last row in place, without copying the others each time.

        Unlike other changes, it also changes rows that were read before, but not those of copies.
        """
        if self._count == self._shared:
            self._move(len(self._storage))
        self._storage[self._count - 1] = row

    def append(self, row: ArrayLike) -> None:
        """Append a row."""
        if self._count == len(self._storage):
            self._move(max(_INITIAL_CAPACITY, int((1 + _RESERVE) * self._count)))
        self._storage[self._count] = row
        self._count += 1

    def _move(self, capacity: int) -> None:
        """Copy the rows to a storage for `capacity` rows; memory that was only reserved is never written to, so the
        system does not provide it before it is needed.
        """
        storage = np.zeros((capacity, *self._shape))
        storage[: self._count] = self.rows
        self._storage, self._shared = storage, 0
