"""The map as a drawing for CAD programs: DXF of AutoCAD Release 12, which all of them read.

One drawing unit is a metre. On the layer WALLS each piece of a wall that was seen is a LINE, on CORNERS each corner is
a POINT, on PATH the way that was driven is a POLYLINE.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ..tum import Floats
from .session import Session
from .thinning import thinned

Group: TypeAlias = tuple[int, object]
"""A line with a code, which says what the value on the next line is."""

LAYERS = {"WALLS": 7, "CORNERS": 1, "PATH": 5}
"""And their colours: black or white, red, blue."""


def write_dxf(path: Path, session: Session) -> None:
    """Write walls, corners and path."""
    groups = [*_header(session), *_tables(), *_entities(session), (0, "EOF")]
    text = "".join(f"{code:>3}\n{value}\n" for code, value in groups)
    path.write_text(text, encoding="ascii", newline="\r\n")


def _header(session: Session) -> Iterator[Group]:
    drawn = np.concatenate([session.lines.end_points().reshape(-1, 2), session.trajectory.poses[:, :2]])
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


def _entities(session: Session) -> Iterator[Group]:
    yield from [(0, "SECTION"), (2, "ENTITIES")]
    for start, end in session.lines.piece_points()[0]:
        yield from [(0, "LINE"), (8, "WALLS"), *_point(start), *_point(end, 1)]
    for position in session.corners.position:
        yield from [(0, "POINT"), (8, "CORNERS"), *_point(position)]
    poses = session.trajectory.poses
    yield from [(0, "POLYLINE"), (8, "PATH"), (66, 1), *_point(np.zeros(2)), (70, 0)]
    for position in poses[thinned(poses), :2]:
        yield from [(0, "VERTEX"), (8, "PATH"), *_point(position)]
    yield from [(0, "SEQEND"), (8, "PATH"), (0, "ENDSEC")]


def _point(position: Floats, number: int = 0) -> list[Group]:
    """The entity's first point, or another; micrometres."""
    x, y = position.tolist()
    return [(10 + number, f"{x:z.6f}"), (20 + number, f"{y:z.6f}"), (30 + number, "0.0")]
