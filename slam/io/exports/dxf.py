"""Write the map as a DXF drawing of AutoCAD Release 12, which all CAD programs read.

One drawing unit is a metre. Each observed piece of a wall is a LINE on the layer WALLS, each corner a POINT on the
layer CORNERS, and the driven path a POLYLINE on the layer PATH. Measurements are aligned DIMENSIONs on the layer
DIMENSIONS, each with a block of its lines and its text, and TEXTs of areas.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ...geometry.segments import Floats
from ...measuring.measurement import Measurement
from ..run_results import RunResults
from .dimension_lines import TEXT_HEIGHT, DimensionLine, area_texts, dimension_lines
from .path_thinning import thin_path

Group: TypeAlias = tuple[int, object]
"""Group code and value, on two consecutive lines of the file."""

LAYERS = {"WALLS": 7, "CORNERS": 1, "PATH": 5}
"""Layers and their colour numbers: black or white, red, blue."""
DIMENSIONS = "DIMENSIONS"
"""Layer of the measurements, in grey."""


def write_dxf(path: Path, results: RunResults, measurements: Sequence[Measurement] = ()) -> None:
    """Write walls, corners and path, and dimensions of measurements."""
    lines = dimension_lines(measurements)
    layers = LAYERS | ({DIMENSIONS: 8} if measurements else {})
    groups = [*_header(results), *_tables(layers), *_blocks(lines), *_entities(results)]
    groups += [*_dimensions(lines), *_area_texts(measurements), (0, "ENDSEC"), (0, "EOF")]
    text = "".join(f"{code:>3}\n{value}\n" for code, value in groups)
    path.write_text(text, encoding="ascii", newline="\r\n")


def _header(results: RunResults) -> Iterator[Group]:
    drawn = np.concatenate([results.walls.end_points().reshape(-1, 2), results.trajectory.poses[:, :2]])
    yield from [(999, "1 unit = 1 m"), (0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009")]
    for name, corner in (("$EXTMIN", drawn.min(axis=0)), ("$EXTMAX", drawn.max(axis=0))):
        yield 9, name
        yield from _point(corner)
    yield 0, "ENDSEC"


def _tables(layers: dict[str, int]) -> Iterator[Group]:
    yield from [(0, "SECTION"), (2, "TABLES")]
    yield from [(0, "TABLE"), (2, "LTYPE"), (70, 1), (0, "LTYPE"), (2, "CONTINUOUS"), (70, 0)]
    yield from [(3, "Solid line"), (72, 65), (73, 0), (40, "0.0"), (0, "ENDTAB")]
    yield from [(0, "TABLE"), (2, "LAYER"), (70, len(layers))]
    for name, colour in layers.items():
        yield from [(0, "LAYER"), (2, name), (70, 0), (62, colour), (6, "CONTINUOUS")]
    yield from [(0, "ENDTAB"), (0, "ENDSEC")]


def _entities(results: RunResults) -> Iterator[Group]:
    yield from [(0, "SECTION"), (2, "ENTITIES")]
    for start, end in results.walls.piece_points()[0]:
        yield from [(0, "LINE"), (8, "WALLS"), *_point(start), *_point(end, 1)]
    for position in results.corners.position:
        yield from [(0, "POINT"), (8, "CORNERS"), *_point(position)]
    poses = results.trajectory.poses
    yield from [(0, "POLYLINE"), (8, "PATH"), (66, 1), *_point(np.zeros(2)), (70, 0)]
    for position in poses[thin_path(poses), :2]:
        yield from [(0, "VERTEX"), (8, "PATH"), *_point(position)]
    yield from [(0, "SEQEND"), (8, "PATH")]


def _blocks(lines: Sequence[DimensionLine]) -> Iterator[Group]:
    """Yield the section of blocks: the picture of each dimension, which programs show without computing it."""
    if not lines:
        return
    yield from [(0, "SECTION"), (2, "BLOCKS")]
    for number, line in enumerate(lines, start=1):
        yield from [(0, "BLOCK"), (8, "0"), (2, f"*D{number}"), (70, 1), *_point(np.zeros(2)), (3, f"*D{number}")]
        for start, end in [line.line, *np.stack([line.measured, line.line], axis=1)]:
            yield from [(0, "LINE"), (8, "0"), *_point(start), *_point(end, 1)]
        yield from _text("0", line.middle, line.text, TEXT_HEIGHT, float(np.degrees(line.angle)))
        yield from [(0, "ENDBLK"), (8, "0")]
    yield 0, "ENDSEC"


def _dimensions(lines: Sequence[DimensionLine]) -> Iterator[Group]:
    for number, line in enumerate(lines, start=1):
        yield from [
            (0, "DIMENSION"),
            (8, DIMENSIONS),
            (2, f"*D{number}"),
            *_point(line.line[1]),
            *_point(line.middle, 1),
        ]
        yield from [(70, 1), (1, _ascii(line.text)), *_point(line.measured[0], 3), *_point(line.measured[1], 4)]


def _area_texts(measurements: Sequence[Measurement]) -> Iterator[Group]:
    for place, text in area_texts(measurements):
        yield from _text(DIMENSIONS, place, text, 2.0 * TEXT_HEIGHT)


def _text(layer: str, middle: Floats, text: str, height: float, turn: float = 0.0) -> list[Group]:
    """Return a TEXT centred at a place and turned by some degrees."""
    size = [(40, f"{height:.3f}"), (1, _ascii(text)), (50, f"{turn:.4f}"), (72, 1)]
    return [(0, "TEXT"), (8, layer), *_point(middle), *size, *_point(middle, 1)]


def _ascii(text: str) -> str:
    """Return a text with the characters that Release 12 has no encoding for replaced."""
    return text.replace("±", "%%p").replace("²", "2")


def _point(position: Floats, number: int = 0) -> list[Group]:
    """Return the groups of an entity's point `number`, rounded to micrometres."""
    x, y = position.tolist()
    return [(10 + number, f"{x:z.6f}"), (20 + number, f"{y:z.6f}"), (30 + number, "0.0")]
