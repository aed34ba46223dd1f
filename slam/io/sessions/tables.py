"""Arrays as columns of Parquet files, and back.

A column is an array (n,), or `Ragged` where a row has several values. The bytes of numbers are written apart, the first
of all, then the second: so what numbers have in common is next to each other, and compresses well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ...errors import MapError
from ...geometry.segments import Floats

Array = NDArray[Any]

TABLE = b"wclm-slam table"
"""Under this name the file's metadata say which table it is."""


@dataclass(frozen=True, slots=True, eq=False)
class Ragged:
    """Values (m,) of n rows, one row's after the other's, and how many each has (n,)."""

    values: Array
    lengths: NDArray[np.int64]

    @property
    def ends(self) -> NDArray[np.int64]:
        """(n + 1,): row k has the values from ends[k] to ends[k + 1]."""
        return np.concatenate([[0], np.cumsum(self.lengths)])


def ragged(rows: Sequence[Array], dtype: type) -> Ragged:
    """The arrays (m_k,) of n rows as one column."""
    lengths = np.array([len(row) for row in rows], dtype=np.int64)
    return Ragged(np.concatenate([np.zeros(0), *rows]).astype(dtype), lengths)


def write_table(path: Path, columns: Mapping[str, Array | Ragged | Sequence[str]]) -> None:
    """Write columns of equal length as one table, named after the file. Raises OSError."""
    arrays = {name: _arrow(column) for name, column in columns.items()}
    table = pa.table(arrays).replace_schema_metadata({TABLE: path.stem.encode()})
    encodings, dictionaries = {}, []
    for field in table.schema:
        place = f"{field.name}.list.element" if pa.types.is_list(field.type) else field.name
        kind = field.type.value_type if pa.types.is_list(field.type) else field.type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            encodings[place] = "BYTE_STREAM_SPLIT"
        else:
            dictionaries.append(place)
    pq.write_table(table, path, compression="zstd", column_encoding=encodings, use_dictionary=dictionaries)


def _arrow(column: Array | Ragged | Sequence[str]) -> pa.Array:
    if isinstance(column, Ragged):
        return pa.ListArray.from_arrays(pa.array(column.ends, pa.int32()), pa.array(column.values))
    return pa.array(column) if isinstance(column, np.ndarray) else pa.array(list(column), pa.string())


class Columns:
    """A table that was read: asks for columns by name and type."""

    def __init__(self, path: Path) -> None:
        """Raises MapError naming the file where it cannot be read or is another table."""
        self._path = path
        try:
            self._table = pq.read_table(path)
        except FileNotFoundError as error:
            raise MapError(f"{path}: is not there; the session is not complete") from error
        except (OSError, pa.ArrowException) as error:
            raise MapError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from error
        named = (self._table.schema.metadata or {}).get(TABLE, b"")
        if named != path.stem.encode():
            raise MapError(f"{path}: is not the table {path.stem} of a session")

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def floats(self, *names: str, finite: bool = True) -> Floats:
        """(n,) for one name, (n, d) for several. Raises MapError where one is not there, or should be `finite` and is
        not."""
        columns = [np.asarray(self._column(name, pa.types.is_floating), dtype=np.float64) for name in names]
        for name, column in zip(names, columns, strict=True):
            self._check(name, not finite or bool(np.isfinite(column).all()), "has values that are not finite")
        return columns[0] if len(names) == 1 else np.column_stack(columns)

    def integers(self, *names: str) -> NDArray[np.int64]:
        """(n,) for one name, (n, d) for several."""
        columns = [np.asarray(self._column(name, pa.types.is_integer), dtype=np.int64) for name in names]
        return columns[0] if len(names) == 1 else np.column_stack(columns)

    def flags(self, name: str) -> NDArray[np.bool_]:
        """(n,)."""
        return np.asarray(self._column(name, pa.types.is_boolean), dtype=bool)

    def words(self, name: str) -> list[str]:
        """n words."""
        return [str(word) for word in self._column(name, pa.types.is_string).tolist()]

    def ragged_floats(self, *names: str, finite: bool = True) -> tuple[Floats, NDArray[np.int64]]:
        """Values (m, d) of the rows, one row's after the other's, and how many each has (n,)."""
        columns = [self._list(name, pa.types.is_floating) for name in names]
        return self._stacked(names, columns, np.float64, finite=finite)

    def ragged_integers(self, *names: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The same of whole numbers."""
        columns = [self._list(name, pa.types.is_integer) for name in names]
        return self._stacked(names, columns, np.int64, finite=True)

    def _stacked(
        self, names: Sequence[str], columns: Sequence[Ragged], dtype: type, *, finite: bool
    ) -> tuple[Array, Array]:
        lengths = columns[0].lengths
        for name, column in zip(names, columns, strict=True):
            self._check(name, np.array_equal(column.lengths, lengths), f"has other lengths than {names[0]}")
            whole = not finite or bool(np.isfinite(column.values).all())
            self._check(name, whole, "has values that are not finite")
        return np.column_stack([column.values for column in columns]).astype(dtype), lengths

    def _column(self, name: str, fits: Any) -> Array:
        array = self._array(name)
        self._check(name, fits(array.type) and not array.null_count, f"has values of another kind: {array.type}")
        return np.asarray(array.to_numpy(zero_copy_only=False))

    def _list(self, name: str, fits: Any) -> Ragged:
        array = self._array(name)
        whole = pa.types.is_list(array.type) and fits(array.type.value_type) and not array.null_count
        self._check(name, whole and not array.values.null_count, f"has values of another kind: {array.type}")
        lengths = np.diff(np.asarray(array.offsets)).astype(np.int64)
        return Ragged(np.asarray(array.flatten().to_numpy(zero_copy_only=False)), lengths)

    def _array(self, name: str) -> pa.Array:
        self._check(name, name in self._table.column_names, "is missing")
        column = self._table.column(name).combine_chunks()
        if isinstance(column, pa.ChunkedArray):  # of an empty table
            return pa.array([], column.type)
        return column

    def _check(self, name: str, holds: bool, wrong: str) -> None:
        if not holds:
            raise MapError(f"{self._path}: the column {name} {wrong}")
