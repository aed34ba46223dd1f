"""Damage of one value after the other in the content of a file."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 2**31, 10**25, 0.5, 1e300, float("nan"), float("inf"), "", "x", [], {}, [[1.0]], {"x": 1},
)  # fmt: skip
WORDS = ("", "x", "nan", "inf", "-1", "0", "1e300", "1" + "0" * 30, "null", '"', "\x00", "1e-300")
MORE = b"\n1,2\n"
"""What is appended to a text."""
Damage = tuple[str, Callable[[], bytes]]
"""What is changed, and a function that returns the damaged content: most damages of a large file are left out."""


def damaged_json(data: bytes) -> Iterator[Damage]:
    """Yield JSON with each value replaced or left out; of a list, the first one and the last one."""
    yield from damaged_ends(data)
    tree = json.loads(data)
    for keys in places(tree):
        for value in VALUES:
            yield f"{keys} = {value!r}"[:200], partial(_json_with, data, keys, value)
        yield f"{keys} left out", partial(_json_without, data, keys)


def _json_with(data: bytes, keys: tuple[Any, ...], value: Any) -> bytes:
    tree = json.loads(data)
    inner(tree, keys)[keys[-1]] = value
    return json.dumps(tree).encode()


def _json_without(data: bytes, keys: tuple[Any, ...]) -> bytes:
    tree = json.loads(data)
    del inner(tree, keys)[keys[-1]]
    return json.dumps(tree).encode()


def places(tree: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys that lead to each value of a tree; of a list, to the first one and the last one."""
    keys = (
        list(tree) if isinstance(tree, dict) else sorted({0, len(tree) - 1}) if isinstance(tree, list) and tree else []
    )
    for key in keys:
        yield (*before, key)
        yield from places(tree[key], (*before, key))


def inner(tree: Any, keys: tuple[Any, ...]) -> Any:
    """Return the part of a tree that has the last of some keys."""
    for key in keys[:-1]:
        tree = tree[key]
    return tree


def damaged_rows(data: bytes) -> Iterator[Damage]:
    """Yield lines of columns with each column replaced, left out or repeated: in the first, second and last line."""
    yield from damaged_ends(data)
    lines = data.decode().splitlines()
    separator = "," if "," in lines[-1] else " "
    for row in sorted({0, 1, len(lines) - 1} & set(range(len(lines)))):
        cells = lines[row].split(separator)
        for column in range(len(cells)):
            for word in WORDS:
                yield _with_cells(lines, row, separator, [*cells[:column], word, *cells[column + 1 :]])
            yield _with_cells(lines, row, separator, [*cells[:column], *cells[column + 1 :]])
            yield _with_cells(lines, row, separator, [*cells[: column + 1], *cells[column:]])
        yield f"line {row} left out", partial(_with_lines, lines, row)
        yield f"line {row} twice", partial(_with_lines, lines, row, lines[row], lines[row])


def _with_cells(lines: list[str], row: int, separator: str, cells: list[str]) -> Damage:
    line = separator.join(cells)
    return f"line {row}: {line}"[:200], partial(_with_lines, lines, row, line)


def _with_lines(lines: list[str], row: int, *instead: str) -> bytes:
    """Return text with some lines, or none, instead of one."""
    return "\n".join([*lines[:row], *instead, *lines[row + 1 :], ""]).encode()


def damaged_settings(data: bytes) -> Iterator[Damage]:
    """Yield settings in TOML or YAML with each value replaced, or its line left out."""
    yield from damaged_ends(data)
    text = data.decode()
    for place in re.finditer(r"(?<=[=:])[ \t]*\S[^\n]*", text):
        for word in (*WORDS, "[]", "{}", "true", "[1, 2]", "nan, nan", "[nan, 0, 0]"):
            yield f"{place[0].strip()} -> {word}"[:200], partial(_with_text, text, place.span(), f" {word}")
    for line in re.finditer(r"[^\n]+\n", text):
        yield f"{line[0].strip()} left out"[:200], partial(_with_text, text, line.span(), "")


def _with_text(text: str, span: tuple[int, int], instead: str) -> bytes:
    """Return a text with another one between two positions."""
    return f"{text[: span[0]]}{instead}{text[span[1] :]}".encode()


def damaged_ends(data: bytes) -> Iterator[Damage]:
    """Yield content that is empty, cut off, longer, binary or of another encoding."""
    yield "empty", bytes
    for share in (0.01, 0.5, 0.99):
        yield f"cut off after {share:g}", partial(bytes, data[: int(share * len(data))])
    yield "more", lambda: data + MORE
    yield "binary", lambda: bytes(range(256))
    yield "UTF-16", lambda: data.decode(errors="replace").encode("utf-16")


def damaged_attributes(data: bytes) -> Iterator[Damage]:
    """Yield XML with the value of each attribute replaced, the first and the last time that it occurs."""
    yield from damaged_ends(data)
    text = data.decode()
    found = list(re.finditer(r'([\w:-]+)="([^"]*)"', text))
    ends = {match[1]: match for match in found} | {f"{match[1]} first": match for match in reversed(found)}
    for match in ends.values():
        for word in WORDS:
            yield f"{match[0]} -> {word}"[:200], partial(_with_text, text, match.span(2), word)


def damaged_lines(data: bytes) -> Iterator[Damage]:
    """Yield text with each line replaced or left out."""
    yield from damaged_ends(data)
    lines = data.decode().splitlines()
    for row, line in enumerate(lines):
        for word in WORDS:
            yield f"line {row}: {line} -> {word}"[:200], partial(_with_lines, lines, row, word)
        yield f"line {row} left out", partial(_with_lines, lines, row)


def damaged_table(data: bytes) -> Iterator[Damage]:
    """Yield a Parquet table with a value of each column replaced in the first and last row, and changed rows."""
    yield from damaged_ends(data)
    table = pq.read_table(io.BytesIO(data))
    rows = list(range(table.num_rows))
    for name, chosen in (("empty table", []), ("first row left out", rows[1:]), ("last row left out", rows[:-1]),
                         ("first row twice", rows[:1] + rows), ("rows reversed", rows[::-1])):  # fmt: skip
        yield name, partial(_with_rows, table, chosen)
    for index, field in enumerate(table.schema):
        yield f"{field.name} left out", partial(_without_column, table, index)
        yield f"{field.name} as text", partial(_with_text_column, table, index)
        for row in sorted({0, len(rows) - 1} & set(rows)):
            for value in _cells(table.column(index)[row].as_py(), field.type):
                yield f"{field.name}[{row}] = {value}"[:200], partial(_with_value, table, index, row, value)


def _with_rows(table: pa.Table, rows: list[int]) -> bytes:
    return _written(table.take(pa.array(rows, pa.int64())))


def _without_column(table: pa.Table, index: int) -> bytes:
    return _written(table.remove_column(index))


def _with_text_column(table: pa.Table, index: int) -> bytes:
    words = pa.array([str(value) for value in table.column(index).to_pylist()])
    return _written(table.set_column(index, table.field(index).with_type(words.type), words))


def _with_value(table: pa.Table, index: int, row: int, value: Any) -> bytes:
    values, field = table.column(index).to_pylist(), table.field(index)
    changed = pa.array([*values[:row], value, *values[row + 1 :]], field.type)
    return _written(table.set_column(index, field, changed))


def _cells(value: Any, kind: pa.DataType) -> Iterator[Any]:
    """Yield unusual values of a type in place of one; lists with another first value or of another length."""
    if pa.types.is_list(kind):
        yield from ([], value[:-1], [*value, *value[-1:]])
        yield from ([one, *value[1:]] for one in _cells(None, kind.value_type))
        return
    yield None
    if pa.types.is_floating(kind):
        yield from (float("nan"), float("inf"), 0.0, -1.0, 1e-30, 1e30, 1e9)
    elif pa.types.is_boolean(kind):
        yield from (True, False)
    elif pa.types.is_integer(kind):
        yield from (-1, 0, 1, 1000, 2**31 - 1, -(2**31))
    else:
        yield from ("", "x", "\x00", 5000 * "x")


def _written(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()
