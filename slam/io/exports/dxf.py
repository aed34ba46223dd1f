"""Write the map as a DXF drawing of AutoCAD Release 12, which all CAD programs read.

One drawing unit is a metre. Each observed piece of a wall is a LINE on the layer WALLS, each corner a POINT on the
layer CORNERS, and the driven path a POLYLINE on the layer PATH.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ...geometry.segments import Floats
from ..run_results import RunResults
from .path_thinning import thin_path

Group: TypeAlias = tuple[int, object]
"""Group code and value, on two consecutive lines of the file."""

LAYERS = {"WALLS": 7, "CORNERS": 1, "PATH": 5}
"""Layers and their colour numbers: black or white, red, blue."""


def write_dxf(path: Path, results: RunResults) -> None:
    """Write walls, corners and path."""
    groups = [*_header(results), *_tables(), *_entities(results), (0, "EOF")]
    text = "".join(f"{code:>3}\n{value}\n" for code, value in groups)
    path.write_text(text, encoding="ascii", newline="\r\n")


def _header(results: RunResults) -> Iterator[Group]:
    drawn = np.concatenate([results.walls.end_points().reshape(-1, 2), results.trajectory.poses[:, :2]])
    yield from [(999, "1 unit = 1 m"), (0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009")]
    for name, corner in (("$EXTMIN", drawn.min(axis=0)), ("$EXTMAX", drawn.max(axis=0))):
        yield 9, name
        yield from _point(corner)
    yield 0, "ENDSEC"


def _tables() -> Iterator[Group]:
    yield from [(0, "SECTION"), (2, "TABLES")]
    yield from [(0, "TABLE"), (2, "LTYPE"), (70, 1), (0, "LTYPE"), (2, "CONTINUOUS"), (70, 0)]
    yield from [(3, "Solid line"), (72, 65), (73, 0), (40, "0.0"), (0, "ENDTAB")]
    yield from [(0, "TABLE"), (2, "LAYER"), (70, len(LAYERS))]
    for name, colour in LAYERS.items():
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
    yield from [(0, "SEQEND"), (8, "PATH"), (0, "ENDSEC")]


def _point(position: Floats, number: int = 0) -> list[Group]:
    """Return the groups of an entity's point `number`, rounded to micrometres."""
    x, y = position.tolist()
    return [(10 + number, f"{x:z.6f}"), (20 + number, f"{y:z.6f}"), (30 + number, "0.0")]
