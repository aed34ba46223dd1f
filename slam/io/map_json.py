"""Write and read `map.json`: walls and corners, one per line, for use without this program.

The file states its format and version; a reader refuses versions that it does not support. A wall has a frame of its
own, to which the other values refer:

    frame         [x, y, heading] in the map: x runs along the wall; the wall is seen from the frame's left (y > 0)
    low, high     ends of the wall along the frame's x (m)
    start, end    the same as points in the map
    covariance    2 x 2, of the offset across the wall (m) and its heading (rad) at the frame's origin; null if unknown
    pieces        observed parts of the wall, [from, to] along x (m): between them there may be doors
    observations  number of keyframes that observed it

Version 1 had no pieces: the wall is read as a single piece.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.immutable import immutable
from drivers.validation import first_problem

from ..errors import MapError
from ..mapping.map_features import MapCorners, MapWalls
from .json_files import read_json, to_json_types

FORMAT = "wclm-slam map"
MAP_VERSION = 2
SUPPORTED_VERSIONS = (1, 2)

MAX_EXTENT = 1e5
"""Metres from a wall's frame to its ends: beyond any building. Commands divide walls into short stretches."""

_UNKNOWN_COVARIANCE = np.full((2, 2), np.nan)

Finite = Annotated[float, Field(allow_inf_nan=False)]
Along = Annotated[float, Field(ge=-MAX_EXTENT, le=MAX_EXTENT, allow_inf_nan=False)]
Identity = Annotated[int, Field(ge=0, lt=1 << 31)]
Count = Annotated[int, Field(ge=0, lt=1 << 31)]
Matrix = tuple[tuple[Finite, Finite], tuple[Finite, Finite]]


class _Record(BaseModel):
    """Part of the file. Values are checked when it is read, and not when it is written: no map may be lost by that."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class _Line(_Record):
    identity: Identity
    frame: tuple[Finite, Finite, Finite]
    low: Along
    high: Along
    start: tuple[Finite, Finite]
    end: tuple[Finite, Finite]
    pieces: list[tuple[Along, Along]] | None = None
    observations: Count
    covariance: Matrix | None


class _Corner(_Record):
    identity: Identity
    position: tuple[Finite, Finite]
    lines: tuple[Identity | Literal[-1], Identity | Literal[-1]]
    observations: Count
    covariance: Matrix | None


class _Units(_Record):
    length: Literal["m"] = "m"
    angle: Literal["rad"] = "rad"


class _Map(_Record):
    format: str = FORMAT
    version: int = MAP_VERSION
    frame: Literal["map"] = "map"
    units: _Units = _Units()
    lines: list[_Line]
    corners: list[_Corner]


@immutable
class MapFile:
    """Contents of a map file."""

    walls: MapWalls
    corners: MapCorners


def write_map(path: Path, walls: MapWalls, corners: MapCorners) -> None:
    """Write the map. Values that are not finite become null; if one is no covariance, the file cannot be read."""
    ends = walls.end_points()
    document = _Map.model_construct(
        lines=[
            _Line.model_construct(
                identity=int(walls.identity[k]),
                frame=_rounded(walls.frame[k]),
                low=_rounded(walls.low[k]),
                high=_rounded(walls.high[k]),
                start=_rounded(ends[k, 0]),
                end=_rounded(ends[k, 1]),
                pieces=_rounded(walls.pieces[k]),
                observations=int(walls.observations[k]),
                covariance=_matrix(walls.covariance[k]),
            )
            for k in range(len(walls))
        ],
        corners=[
            _Corner.model_construct(
                identity=int(corners.identity[k]),
                position=_rounded(corners.position[k]),
                lines=(int(corners.walls[k, 0]), int(corners.walls[k, 1])),
                observations=int(corners.observations[k]),
                covariance=_matrix(corners.covariance[k]),
            )
            for k in range(len(corners))
        ],
    )
    path.write_text(_to_json(document), encoding="utf-8", newline="\n")


def read_map(path: Path | str) -> MapFile:
    """Read a map. Raises MapError naming the file and the problem: not JSON, another version, an invalid value."""
    data = read_json(Path(path))
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise MapError(f'{path}: is not a map: its format is not "{FORMAT}"')
    if data.get("version") not in SUPPORTED_VERSIONS:
        supported = " and ".join(str(version) for version in SUPPORTED_VERSIONS)
        version = reprlib.repr(data.get("version"))
        raise MapError(f"{path}: has format version {version}; this program reads versions {supported}")
    try:
        document = _Map.model_validate(data)
    except ValidationError as error:
        raise MapError(f"{path}: {first_problem(error)}") from error
    return MapFile(_lines(document.lines), _corners(document.corners))


def _lines(records: Sequence[_Line]) -> MapWalls:
    return MapWalls(
        identity=_integers([r.identity for r in records]),
        frame=np.array([r.frame for r in records], float).reshape(-1, 3),
        low=np.array([r.low for r in records], float),
        high=np.array([r.high for r in records], float),
        observations=_integers([r.observations for r in records]),
        covariance=_covariances([r.covariance for r in records]),
        pieces=tuple(np.array(r.pieces or [(r.low, r.high)], float) for r in records),
    )


def _corners(records: Sequence[_Corner]) -> MapCorners:
    return MapCorners(
        identity=_integers([r.identity for r in records]),
        position=np.array([r.position for r in records], float).reshape(-1, 2),
        covariance=_covariances([r.covariance for r in records]),
        walls=_integers([r.lines for r in records]).reshape(-1, 2),
        observations=_integers([r.observations for r in records]),
    )


def _integers(values: Sequence[Any]) -> NDArray[np.int64]:
    return np.array(values, dtype=np.int64)


def _covariances(matrices: Sequence[Matrix | None]) -> NDArray[np.float64]:
    return np.array([_UNKNOWN_COVARIANCE if m is None else m for m in matrices], float).reshape(-1, 2, 2)


def _rounded(values: NDArray[np.float64]) -> Any:
    """Return values rounded to nanometres, which keeps the file short; adding zero turns -0.0 into 0.0."""
    return (np.round(values, 9) + 0.0).tolist()


def _matrix(covariance: NDArray[np.float64]) -> Any:
    """Return a covariance with nine significant digits; None if it is not finite."""
    if not np.isfinite(covariance).all():
        return None
    return [[float(f"{value:.9g}") for value in row] for row in covariance.tolist()]


def _to_json(document: _Map) -> str:
    """Return JSON with one wall or corner per line, for reading and comparing with `diff`."""
    data = to_json_types(document.model_dump(warnings=False))
    parts = []
    for name, value in data.items():
        if isinstance(value, list):
            records = ",\n".join(f"    {json.dumps(record, allow_nan=False)}" for record in value)
            parts.append(f'  "{name}": [\n{records}\n  ]' if value else f'  "{name}": []')
        else:
            parts.append(f'  "{name}": {json.dumps(value)}')
    return "{\n" + ",\n".join(parts) + "\n}\n"
