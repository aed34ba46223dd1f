"""Array to which rows are appended without copying it each time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .segments import Floats

# Rows for which memory is reserved at first; it doubles as needed. Origin: numerical.
_INITIAL_CAPACITY = 64


class GrowingArray:
    """Rows of floats, all of one shape. A change leaves the rows that were read before as they were."""

    def __init__(self, shape: Sequence[int], rows: ArrayLike = ()) -> None:
        """Create an array with rows of a shape."""
        self._shape = tuple(shape)
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
        return other

    def replace(self, rows: ArrayLike) -> None:
        """Replace all rows by (n, ...) others, which are copied."""
        new = np.asarray(rows, dtype=np.float64).reshape(-1, *self._shape)
        self._count = len(new)
        self._storage: Floats = np.zeros((max(_INITIAL_CAPACITY, len(new)), *self._shape))
        self._storage[: len(new)] = new

    def replace_last(self, rows: ArrayLike) -> None:
        """Replace the last rows by (m, ...) others."""
        new = np.asarray(rows, dtype=np.float64).reshape(-1, *self._shape)
        self._move(len(self._storage))
        self._storage[self._count - len(new) : self._count] = new

    def append(self, row: ArrayLike) -> None:
        """Append a row."""
        if self._count == len(self._storage):
            self._move(max(_INITIAL_CAPACITY, 2 * self._count))
        self._storage[self._count] = row
        self._count += 1

    def _move(self, capacity: int) -> None:
        """Copy the rows to a storage for `capacity` rows; memory that was only reserved is never written to, so the
        system does not provide it before it is needed.
        """
        storage = np.zeros((capacity, *self._shape))
        storage[: self._count] = self.rows
        self._storage = storage
