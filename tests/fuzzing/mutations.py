"""Random damage of files: of bytes, of numbers in text, of values in JSON and in tables, and of compressed content."""

from __future__ import annotations

import copy
import gzip
import io
import json
import random
import re
from collections.abc import Callable
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

Random = random.Random
Mutation = Callable[[bytes, Random], bytes]

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
WORDS = (
    b"0", b"-0", b"-1", b"1e-300", b"1e300", b"1e999", b"-1e15", b"nan", b"inf", b"-inf", b"2147483648",
    b"1" + b"0" * 25, b"", b"x", b"\xff", b"true", b"null", b"\n", b",", b'"', b"[", b"]", b"{", b"}", b"9" * 5000,
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**31, 2**63, 10**25, 0.5, -1e-300, 1e300, float("nan"), float("inf"), "", "x", "1\n2",
    "\ud800", "x" * 5000, [], [0], [[]], {}, {"x": 1},
)  # fmt: skip
NUMBERS = (0, -1, 1, 2, 127, -128, 255, 2**15, 2**31 - 1, -(2**31), 2**32, 2**63 - 1, -(2**63))
FLOATS = (0.0, -1.0, 1e-300, 1e16, -1e16, 1e300, float("nan"), float("inf"), -float("inf"))
MAX_CHANGES = 4


def mutate_bytes(data: bytes, source: Random) -> bytes:
    """Change bits, bytes, integers or floats, or remove, repeat, move or cut off parts."""
    content = bytearray(data)
    for _ in range(source.randint(1, MAX_CHANGES)):
        at, size = source.randrange(len(content) + 1), source.choice((1, 2, 4, 8, source.randrange(1, 200)))
        match source.randrange(9):
            case 0 if at < len(content):
                content[at] ^= 1 << source.randrange(8)
            case 1:
                content[at : at + size] = bytes([source.choice((0, 1, 127, 128, 255))]) * min(size, len(content) - at)
            case 2:
                content[at : at + size] = source.randbytes(min(size, len(content) - at))
            case 3:
                width = source.choice((1, 2, 4, 8))
                number = source.choice(NUMBERS) % (1 << 8 * width)
                content[at : at + width] = number.to_bytes(width, "little")
            case 4:
                del content[at : at + size]
            case 5:
                content[at:at] = content[at : at + size] * source.choice((1, 1, 2, 50))
            case 6:
                content[at:at] = source.randbytes(size)
            case 7:
                del content[at:]
            case 8:
                other = source.randrange(len(content) + 1)
                content[at : at + size] = content[other : other + size]
    return bytes(content)


def mutate_text(data: bytes, source: Random) -> bytes:
    """Replace numbers or words, or remove, repeat or exchange lines; sometimes change bytes."""
    for _ in range(source.randint(1, MAX_CHANGES)):
        lines = data.split(b"\n")
        at, other = source.randrange(len(lines)), source.randrange(len(lines))
        match source.randrange(6):
            case 0 | 1 if places := list(NUMBER.finditer(data)):
                place = source.choice(places)
                data = data[: place.start()] + source.choice(WORDS) + data[place.end() :]
            case 2 if words := list(re.finditer(rb"\S+", data)):
                place = source.choice(words)
                data = data[: place.start()] + source.choice(WORDS) + data[place.end() :]
            case 3:
                del lines[at]
                data = b"\n".join(lines)
            case 4:
                lines[at], lines[other] = lines[other], lines[at] * source.choice((1, 2))
                data = b"\n".join(lines)
            case _:
                data = mutate_bytes(data, source)
    return data


def mutate_json(data: bytes, source: Random) -> bytes:
    """Replace, remove or repeat values; sometimes change the text."""
    if source.random() < 0.2:
        return mutate_text(data, source)
    tree = json.loads(data)
    for _ in range(source.randint(1, MAX_CHANGES)):
        _change_value(tree, source)
    return json.dumps(tree).encode()


def _change_value(tree: Any, source: Random) -> None:
    """Change one value, at a random depth, in place."""
    place, keys = tree, list(tree) if isinstance(tree, dict) else list(range(len(tree)))
    while keys:
        key = source.choice(keys)
        inner = place[key]
        if isinstance(inner, dict | list) and inner and source.random() < 0.85:
            place, keys = inner, list(inner) if isinstance(inner, dict) else list(range(len(inner)))
            continue
        match source.randrange(6):
            case 0:
                del place[key]
            case 1 if isinstance(place, list):
                place.insert(key, copy.deepcopy(inner))  # a later change would change both, or put one into itself
            case 2 if type(inner) in (int, float):
                place[key] = source.choice((*NUMBERS, *FLOATS, inner + 1, -inner))
            case _:
                place[key] = copy.deepcopy(source.choice(VALUES))
        return


def mutate_table(data: bytes, source: Random) -> bytes:
    """Change values of a Parquet table, or remove, repeat or exchange rows or columns; sometimes change bytes."""
    if source.random() < 0.4:
        return mutate_bytes(data, source)
    table = pq.read_table(io.BytesIO(data))
    for _ in range(source.randint(1, MAX_CHANGES)):
        if not table.num_rows or not table.num_columns:
            break
        row, column = source.randrange(table.num_rows), source.randrange(table.num_columns)
        match source.randrange(8):
            case 0:
                rows = [k for k in range(table.num_rows) if k != row]
                table = table.take(pa.array(rows, pa.int64()))
            case 1:
                table = table.take([*range(table.num_rows), row])
            case 2:
                table = table.remove_column(column)
            case _:
                table = _change_cell(table, row, column, source)
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def _change_cell(table: pa.Table, row: int, column: int, source: Random) -> pa.Table:
    values, field = table.column(column).to_pylist(), table.schema.field(column)
    if isinstance(values[row], list):
        cells, kind = values[row], field.type.value_type
        if cells and source.random() < 0.8:
            cells[source.randrange(len(cells))] = _cell(kind, source)
        else:
            values[row] = cells[:-1] if source.random() < 0.5 else [*cells, _cell(kind, source)]
    else:
        values[row] = _cell(field.type, source)
    return table.set_column(column, field, pa.array(values, field.type))


def _cell(kind: pa.DataType, source: Random) -> Any:
    """Return an unusual value of a type."""
    if source.random() < 0.05:
        return None
    if pa.types.is_floating(kind):
        return source.choice(FLOATS)
    if pa.types.is_boolean(kind):
        return source.random() < 0.5
    if pa.types.is_integer(kind):
        low, bits = (0, kind.bit_width) if pa.types.is_unsigned_integer(kind) else (-1, kind.bit_width - 1)
        return source.choice([n for n in (*NUMBERS, 1000, 3) if low * 2**bits <= n < 2**bits])
    return source.choice(("", "x", "x" * 5000, "odometry", "wall"))


def mutate_gzip(data: bytes, source: Random) -> bytes:
    """Change the text that is compressed; sometimes the compressed bytes."""
    if source.random() < 0.2:
        return mutate_bytes(data, source)
    return gzip.compress(mutate_text(gzip.decompress(data), source), compresslevel=1)
