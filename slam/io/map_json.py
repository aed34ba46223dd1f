"""The map on disk: `map.json`, one wall or corner a line, complete enough to be used without this program.

The format carries its name and version. A reader takes the versions it knows and refuses others. A wall is a frame
standing on it, so the numbers below need no second convention:

    frame         [x, y, heading] in the map: x runs along the wall; the wall is seen from the frame's left (y > 0)
    low, high     how far along the frame's x the wall is known
    start, end    the same as points in the map
    covariance    2 x 2, of the offset across the wall (m) and its heading (rad) at the frame's origin; null if unknown
    pieces        the stretches of it that were seen, [from, to] along x: between them there may be doors
    observations  in how many keyframes it was seen

Version 1 had no pieces; such a wall reads as one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import MapError
from ..events import MapCorners, MapWalls

FORMAT = "wclm-slam map"
VERSION = 2
KNOWN_VERSIONS = (1, 2)

_UNKNOWN = np.full((2, 2), np.nan)

Finite = Annotated[float, Field(allow_inf_nan=False)]
Matrix = tuple[tuple[Finite, Finite], tuple[Finite, Finite]]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Line(_Record):
    identity: int
    frame: tuple[Finite, Finite, Finite]
    low: Finite
    high: Finite
    start: tuple[Finite, Finite]
    end: tuple[Finite, Finite]
    pieces: list[tuple[Finite, Finite]] | None = None
    observations: int = Field(ge=0)
    covariance: Matrix | None


class _Corner(_Record):
    identity: int
    position: tuple[Finite, Finite]
    lines: tuple[int, int]
    observations: int = Field(ge=0)
    covariance: Matrix | None


class _Units(_Record):
    length: Literal["m"] = "m"
    angle: Literal["rad"] = "rad"


class _Map(_Record):
    format: str = FORMAT
    version: int = VERSION
    frame: Literal["map"] = "map"
    units: _Units = _Units()
    lines: list[_Line]
    corners: list[_Corner]


@dataclass(frozen=True, slots=True, eq=False)
class MapFile:
    """What a map file holds."""

    lines: MapWalls
    corners: MapCorners


def write_map(path: Path, lines: MapWalls, corners: MapCorners) -> None:
    """Write the map. Raises MapError where a position is not finite; covariances that are not become null."""
    ends = lines.end_points()
    try:
        document = _Map(
            lines=[
                _Line(
                    identity=int(lines.identity[k]),
                    frame=_rounded(lines.frame[k]),
                    low=_rounded(lines.low[k]),
                    high=_rounded(lines.high[k]),
                    start=_rounded(ends[k, 0]),
                    end=_rounded(ends[k, 1]),
                    pieces=_rounded(lines.pieces[k]),
                    observations=int(lines.observations[k]),
                    covariance=_matrix(lines.covariance[k]),
                )
                for k in range(len(lines))
            ],
            corners=[
                _Corner(
                    identity=int(corners.identity[k]),
                    position=_rounded(corners.position[k]),
                    lines=(int(corners.lines[k, 0]), int(corners.lines[k, 1])),
                    observations=int(corners.observations[k]),
                    covariance=_matrix(corners.covariance[k]),
                )
                for k in range(len(corners))
            ],
        )
    except ValidationError as error:
        raise MapError(f"{path}: the map cannot be written: {_first(error)}") from error
    path.write_text(_one_record_a_line(document), encoding="utf-8", newline="\n")


def read_map(path: Path) -> MapFile:
    """Read a map. Raises MapError naming the file and what is wrong: no JSON, another version, a bad value."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise MapError(f"{path}: is not JSON: {error}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise MapError(f'{path}: is not a map: its format is not "{FORMAT}"')
    if data.get("version") not in KNOWN_VERSIONS:
        known = " and ".join(str(version) for version in KNOWN_VERSIONS)
        raise MapError(f"{path}: has format version {data.get('version')}; this program reads versions {known}")
    try:
        document = _Map.model_validate(data)
    except ValidationError as error:
        raise MapError(f"{path}: {_first(error)}") from error
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
        lines=_integers([r.lines for r in records]).reshape(-1, 2),
        observations=_integers([r.observations for r in records]),
    )


def _integers(values: Sequence[Any]) -> NDArray[np.int64]:
    return np.array(values, dtype=np.int64)


def _covariances(matrices: Sequence[Matrix | None]) -> NDArray[np.float64]:
    return np.array([_UNKNOWN if m is None else m for m in matrices], float).reshape(-1, 2, 2)


def _rounded(values: NDArray[np.float64]) -> Any:
    """To the nanometre: enough to be exact for every purpose, and short to read. Adding zero turns -0.0 into 0.0."""
    return (np.round(values, 9) + 0.0).tolist()


def _matrix(covariance: NDArray[np.float64]) -> Any:
    if not np.isfinite(covariance).all():
        return None
    return [[float(f"{value:.9g}") for value in row] for row in covariance.tolist()]


def _first(error: ValidationError) -> str:
    detail = error.errors()[0]
    return f"{'.'.join(str(part) for part in detail['loc'])}: {detail['msg'].lower()}"


def _one_record_a_line(document: _Map) -> str:
    """JSON that a person can scan and `diff` can compare."""
    data = document.model_dump(mode="json")
    parts = []
    for name, value in data.items():
        if isinstance(value, list):
            records = ",\n".join(f"    {json.dumps(record, allow_nan=False)}" for record in value)
            parts.append(f'  "{name}": [\n{records}\n  ]' if value else f'  "{name}": []')
        else:
            parts.append(f'  "{name}": {json.dumps(value)}')
    return "{\n" + ",\n".join(parts) + "\n}\n"
