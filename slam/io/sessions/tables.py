"""Write NumPy arrays as columns of Parquet files, and read them back with checks.

A column is an array (n,), or `Ragged` if a row has several values. Numbers are encoded as BYTE_STREAM_SPLIT: the first
bytes of all values, then the second bytes, and so on. Bytes that values have in common are adjacent then and compress
well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from drivers.immutable import immutable

from ...bounds import MAX_DEVIATION, MAX_LENGTH, MAX_MAGNITUDE, MIN_DEVIATION
from ...errors import MapError, first_line
from ...geometry.segments import Floats

Array = NDArray[Any]

TABLE_NAME = b"wclm-slam table"
"""Key of the file's metadata that holds the table's name."""
VALUE_SIZE = 8
"""Bytes of a value in memory."""
MAX_RATIO = 200
"""Ratio of the sizes of a table in memory and as a file. Tables of long sessions have 3 to 20."""
POSE_COLUMNS = ("x", "y", "heading")
"""Columns of poses, or ends of their names."""
ROUNDING = 1e-9
"""Relative rounding error of computed covariances, with a large margin: 1e-15 occurs."""
ALWAYS_ALLOWED = 1 << 26
"""Bytes of a table in memory, whatever the ratio."""


@immutable
class Ragged:
    """Column with any number of values in each of its n rows.

    values   (m,) of all rows, concatenated
    lengths  (n,) number of values of each row
    """

    values: Array
    lengths: NDArray[np.int64]

    @property
    def ends(self) -> NDArray[np.int64]:
        """(n + 1,): the values of row k are values[ends[k] : ends[k + 1]]."""
        return np.concatenate([[0], np.cumsum(self.lengths)])


Column = Array | Ragged | Sequence[str]
Columns = Mapping[str, Column]
"""Columns of a table by their names."""


def to_ragged(rows: Sequence[Array], dtype: type) -> Ragged:
    """Concatenate the arrays (m_k,) of n rows into one column."""
    lengths = np.array([len(row) for row in rows], dtype=np.int64)
    return Ragged(np.concatenate([np.zeros(0), *rows]).astype(dtype), lengths)


def write_table(path: Path, columns: Columns) -> None:
    """Write columns of equal length as one table, named after the file. Raises OSError."""
    write_row_groups(path, [columns])


def write_row_groups(path: Path, groups: Iterable[Columns]) -> None:
    """Write the rows of one table group by group, at least one: only one is in memory at a time. Raises OSError.

    Each has the same columns.
    """
    tables = (pa.table({name: _to_arrow(column) for name, column in group.items()}) for group in groups)
    first = next(tables)
    encodings, dictionaries = {}, []
    for field in first.schema:
        leaf = f"{field.name}.list.element" if pa.types.is_list(field.type) else field.name
        kind = field.type.value_type if pa.types.is_list(field.type) else field.type
        if pa.types.is_integer(kind) or pa.types.is_floating(kind):
            encodings[leaf] = "BYTE_STREAM_SPLIT"
        else:
            dictionaries.append(leaf)
    schema = first.schema.with_metadata({TABLE_NAME: path.stem.encode()})
    with pq.ParquetWriter(
        path,
        schema,
        compression="zstd",
        column_encoding=encodings,
        use_dictionary=dictionaries,
        memory_pool=pa.system_memory_pool(),  # reuses what the run has freed; Arrow's own pool would add some 10 MB
    ) as writer:
        for table in chain([first], tables):
            writer.write_table(table)


def _to_arrow(column: Column) -> pa.Array:
    if isinstance(column, Ragged):
        return pa.ListArray.from_arrays(_wrapped(column.ends.astype(np.int32)), _wrapped(column.values))
    if isinstance(column, np.ndarray):
        return _wrapped(column)
    words = [word.encode() for word in column]
    ends = np.cumsum([0, *map(len, words)]).astype(np.int32)
    return pa.StringArray.from_buffers(len(words), pa.py_buffer(ends), pa.py_buffer(b"".join(words)))


def _wrapped(values: Array) -> pa.Array:
    """Return values (n,) as an Arrow array. `pa.array` does the same, but it imports pandas, if that is installed."""
    kind = pa.from_numpy_dtype(values.dtype)
    data = np.packbits(values, bitorder="little") if kind == pa.bool_() else np.ascontiguousarray(values)
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(data)])


def _unwrapped(array: pa.Array) -> Array:
    """Return the values (n,) of an Arrow array without nulls; its own conversion imports pandas too."""
    dtype, data = np.dtype(array.type.to_pandas_dtype()), array.buffers()[1]
    if not len(array) or data is None:
        return np.zeros(0, dtype)
    if dtype == np.bool_:
        bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little", count=array.offset + len(array))
        return bits[array.offset :].astype(np.bool_)
    return np.frombuffer(data, dtype, len(array), array.offset * dtype.itemsize)


def are_covariances(matrices: Floats) -> bool:
    """Return True if all symmetric matrices (n, d, d) are positive definite, and so far from singular that they can be
    inverted.
    """
    deviations = np.sqrt(np.diagonal(matrices, axis1=1, axis2=2).clip(min=0.0))
    if not ((deviations > MIN_DEVIATION) & (deviations < MAX_DEVIATION)).all():
        return False
    correlations = matrices / deviations[:, :, None] / deviations[:, None, :]
    return bool((np.linalg.eigvalsh(correlations) > 0.0).all()) if len(matrices) else True


def are_semidefinite(matrices: Floats) -> bool:
    """Return True if no symmetric matrix (n, d, d) has a negative variance in any direction, except for rounding."""
    scales = np.sqrt(np.diagonal(matrices, axis1=1, axis2=2).clip(min=0.0))
    scales[scales == 0.0] = 1.0
    correlations = matrices / scales[:, :, None] / scales[:, None, :]
    return bool((np.linalg.eigvalsh(correlations) >= -ROUNDING).all()) if len(matrices) else True


class TableReader:
    """Table of a Parquet file; returns columns by name and checks their type.

    All methods raise MapError naming the file and the column if it is missing or has another type.
    """

    def __init__(self, path: Path) -> None:
        """Read the file. Raises MapError naming it if it cannot be read or is another table."""
        self._path = path
        try:
            self._table = self._checked_file().read()
            self._names = self._table.column_names
            name = (self._table.schema.metadata or {}).get(TABLE_NAME, b"")
        except FileNotFoundError as error:
            raise MapError(f"{path}: file is missing; the session is incomplete") from error
        except (OSError, ValueError, pa.ArrowException) as error:
            raise MapError(f"{path}: cannot be read: {first_line(error)}") from error
        if name != path.stem.encode():
            raise MapError(f"{path}: is not the table {path.stem} of a session")

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def __contains__(self, name: object) -> bool:
        """Return True if the table has a column; later versions have added some."""
        return name in self._names

    def _checked_file(self) -> pq.ParquetFile:
        """Open the file. Raises MapError if the table would be far larger in memory than any that is written.

        Raises ValueError or ArrowException if the file is damaged.
        """
        file = pq.ParquetFile(self._path)
        groups = [file.metadata.row_group(k) for k in range(file.metadata.num_row_groups)]
        limit = max(ALWAYS_ALLOWED, MAX_RATIO * self._path.stat().st_size)
        size = sum(group.total_byte_size for group in groups)
        if size > limit:
            raise MapError(f"{self._path}: unpacks to {size} bytes, which is more than {MAX_RATIO} times its size")
        # Reads all columns with little memory. A damaged description of a column is an error here; in `column` below,
        # PyArrow would end the whole process.
        file.scan_contents()
        values = sum(group.column(k).num_values for group in groups for k in range(group.num_columns))
        if VALUE_SIZE * values > limit:
            raise MapError(f"{self._path}: has {values} values, which is more than {MAX_RATIO} times its size")
        return file

    def floats(self, *names: str, finite: bool = True, limit: float = MAX_LENGTH) -> Floats:
        """Return columns of floats: (n,) for one name, (n, d) for several.

        Raises MapError if a value is not finite, unless `finite` is False, or beyond `limit`.
        """
        columns = [np.asarray(self._column(name, pa.types.is_floating), dtype=np.float64) for name in names]
        for name, column in zip(names, columns, strict=True):
            self._check_values(name, column, finite=finite, limit=limit)
        return columns[0] if len(names) == 1 else np.column_stack(columns)

    def integers(self, *names: str) -> NDArray[np.int64]:
        """Return columns of integers: (n,) for one name, (n, d) for several."""
        columns = [np.asarray(self._column(name, pa.types.is_integer), dtype=np.int64) for name in names]
        return columns[0] if len(names) == 1 else np.column_stack(columns)

    def booleans(self, name: str) -> NDArray[np.bool_]:
        """Return a column of booleans (n,)."""
        return np.asarray(self._column(name, pa.types.is_boolean), dtype=bool)

    def strings(self, name: str) -> list[str]:
        """Return a column of n strings."""
        try:
            return [str(word) for word in self._typed(name, pa.types.is_string).to_pylist()]
        except UnicodeDecodeError as error:
            raise MapError(f"{self._path}: the column {name} has text that is not UTF-8") from error

    def ragged_floats(
        self, *names: str, finite: bool = True, limit: float | Sequence[float] = MAX_LENGTH
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Return ragged columns of equal lengths: the concatenated values (m, d) and the length of each row (n,).

        Raises MapError if lengths differ, or if a value is not finite, unless `finite` is False, or beyond `limit`,
        which is that of all columns or of each.
        """
        columns = [self._ragged(name, pa.types.is_floating) for name in names]
        return self._stack(names, columns, np.float64, finite=finite, limit=limit)

    def ragged_integers(self, *names: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return ragged columns of integers, like `ragged_floats`."""
        columns = [self._ragged(name, pa.types.is_integer) for name in names]
        return self._stack(names, columns, np.int64, finite=True, limit=MAX_MAGNITUDE)

    def _stack(
        self,
        names: Sequence[str],
        columns: Sequence[Ragged],
        dtype: type,
        *,
        finite: bool,
        limit: float | Sequence[float],
    ) -> tuple[Array, Array]:
        lengths, limits = columns[0].lengths, np.broadcast_to(limit, len(names)).tolist()
        for name, column, largest in zip(names, columns, limits, strict=True):
            self._check(name, np.array_equal(column.lengths, lengths), f"has other lengths than {names[0]}")
            self._check_values(name, column.values, finite=finite, limit=largest)
        return np.column_stack([column.values for column in columns]).astype(dtype), lengths

    def _column(self, name: str, has_type: Any) -> Array:
        return _unwrapped(self._typed(name, has_type))

    def _typed(self, name: str, has_type: Any) -> pa.Array:
        array = self._array(name)
        self._check(name, has_type(array.type) and not array.null_count, f"has values of another type: {array.type}")
        return array

    def _ragged(self, name: str, has_type: Any) -> Ragged:
        array = self._array(name)
        valid = pa.types.is_list(array.type) and has_type(array.type.value_type) and not array.null_count
        self._check(name, valid and not array.values.null_count, f"has values of another type: {array.type}")
        lengths = np.diff(_unwrapped(array.offsets)).astype(np.int64)
        return Ragged(_unwrapped(array.flatten()), lengths)

    def _array(self, name: str) -> pa.Array:
        self._check(name, name in self._names, "is missing")
        column = self._table.column(name).combine_chunks()
        if isinstance(column, pa.ChunkedArray):  # of an empty table
            return pa.nulls(0, column.type)
        return column

    def _check_values(self, name: str, values: Array, *, finite: bool, limit: float) -> None:
        """Raise MapError if a value is not finite, unless `finite` is False, or beyond `limit`."""
        is_finite = np.isfinite(values)
        self._check(name, not finite or bool(is_finite.all()), "has values that are not finite")
        large = np.abs(values[is_finite].astype(np.float64)) > limit
        self._check(name, not large.any(), f"has values beyond {limit:g}")

    def _check(self, name: str, valid: bool, problem: str) -> None:
        if not valid:
            raise MapError(f"{self._path}: the column {name} {problem}")
