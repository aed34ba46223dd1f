"""Tables of a session: what is written is read back, with its types, and text is checked."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from slam.errors import MapError
from slam.io.sessions.tables import TABLE_NAME, TableReader, to_ragged, write_table


@pytest.mark.parametrize("count", [0, 1, 7, 9, 3000])
def test_columns_are_read_as_they_were_written(tmp_path: Path, count: int) -> None:
    random = np.random.default_rng(count)
    columns = {
        "floats": random.normal(size=count),
        "integers": random.integers(-9, 9, count),
        "booleans": random.random(count) < 0.5,
        "words": ["", "Zürich", "a b"] * (count // 3) + ["x"] * (count % 3),
        "rows": to_ragged([random.normal(size=k % 4) for k in range(count)], np.float64),
        "strided": random.normal(size=2 * count)[::2],
    }
    path = tmp_path / "walls.parquet"
    write_table(path, columns)
    table = TableReader(path)
    assert len(table) == count
    np.testing.assert_array_equal(table.floats("floats"), columns["floats"])
    np.testing.assert_array_equal(table.floats("strided"), columns["strided"])
    np.testing.assert_array_equal(table.integers("integers"), columns["integers"])
    np.testing.assert_array_equal(table.booleans("booleans"), columns["booleans"])
    assert table.strings("words") == columns["words"]
    values, lengths = table.ragged_floats("rows")
    np.testing.assert_array_equal(values[:, 0], columns["rows"].values)
    np.testing.assert_array_equal(lengths, columns["rows"].lengths)


def test_values_that_are_not_finite_are_kept_if_that_is_allowed(tmp_path: Path) -> None:
    path = tmp_path / "walls.parquet"
    write_table(path, {"x": np.array([np.nan, np.inf, 1.0])})
    np.testing.assert_array_equal(TableReader(path).floats("x", finite=False), [np.nan, np.inf, 1.0])


def test_text_that_is_not_utf_8_is_an_error_that_names_the_column(tmp_path: Path) -> None:
    path = tmp_path / "walls.parquet"
    ends = pa.py_buffer(np.array([0, 2], np.int32))
    table = pa.table({"words": pa.StringArray.from_buffers(1, ends, pa.py_buffer(b"\xff\xfe"))})
    pq.write_table(table.replace_schema_metadata({TABLE_NAME: b"walls"}), path)
    with pytest.raises(MapError, match="the column words has text that is not UTF-8"):
        TableReader(path).strings("words")


def test_missing_values_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "walls.parquet"
    table = pa.table({"x": pa.array([1.0, None])})
    pq.write_table(table.replace_schema_metadata({TABLE_NAME: b"walls"}), path)
    with pytest.raises(MapError, match="the column x"):
        TableReader(path).floats("x", finite=False)
