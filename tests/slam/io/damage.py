"""Damage of sessions: changes of values in their header and of rows and columns in their tables."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slam.io.output_dir import SESSION
from slam.io.sessions.session import HEADER


def copy_of(intact: Path, folder: Path) -> Path:
    """Return a copy of a run's directory, in an existing folder."""
    return Path(shutil.copytree(intact, folder / "out"))


def change_header(path: Path, keys: list[Any], change: Callable[[Any], Any]) -> None:
    """Replace the value at `keys` in the header of a session by what a function makes of it; of None if it is new."""
    file = path / SESSION / HEADER
    data = record = json.loads(file.read_text())
    for key in keys[:-1]:
        record = record[key]
    record[keys[-1]] = change(record[keys[-1]] if keys[-1] in record or isinstance(record, list) else None)
    file.write_text(json.dumps(data))


def change_rows(file: Path, change: Callable[[list[int]], list[int]]) -> None:
    """Write a table with the rows that a function makes of all rows."""
    table = pq.read_table(file)
    pq.write_table(table.take(pa.array(change(list(range(len(table)))), pa.int64())), file)


def change_column(file: Path, name: str, value: Any) -> None:
    """Replace the last value of a column, of a list its first value."""
    table = pq.read_table(file)
    column = table.column(name)
    values = column.to_pylist()
    row = max(k for k, v in enumerate(values) if v not in (value, []))
    values[row] = [value, *values[row][1:]] if isinstance(values[row], list) else value
    index = table.column_names.index(name)
    pq.write_table(table.set_column(index, table.schema.field(index), pa.array(values, column.type)), file)
