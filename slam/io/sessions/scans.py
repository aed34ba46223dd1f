"""What was sighted, and where it belongs: a row for each scan.

Walls and corners are written in single precision, which at ten metres is a micrometre, and points to the millimetre:
they are no better than that. Only what the last keyframes saw is written to the last bit, in a table of its own: the
next scans are laid over it, and what goes on from there should be what it would have been.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...errors import MapError
from ...geometry.segments import CornerPoints, Floats, Integers, Segments
from ...mapping.keyframes import LandmarkIds
from ...mapping.mapper import KEPT_VIEWS
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...matching.likelihood_field import ScanPoints
from ...matching.line_matcher import ScanFeatures
from ...preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from .tables import Columns, Ragged, ragged, write_table

Number = TypeVar("Number", bound=np.generic)

POINT_UNIT = 1e-3  # metres
FARTHEST = 2e6  # of these units: what no lidar reaches
RECENT = KEPT_VIEWS  # keyframes whose sightings are kept to the last bit; of fewer the points are used
UPPER = np.triu_indices(3)
INFORMATION = ("xx", "xy", "xh", "yy", "yh", "hh")
SEGMENT = ("x", "y", "heading", "half_length", "offset_offset", "offset_heading", "heading_heading")
CORNER = ("x", "y", "xx", "xy", "yy")


@dataclass(frozen=True, slots=True, eq=False)
class StoredScans:
    """All sightings, the path through them, and the keyframes among them: their stamps and what they see by name."""

    scans: list[ProcessedScan]
    path: TrajectoryBuilder
    keyframe_stamps: list[float]
    names: list[LandmarkIds]


def write_scans(file: Path, sighted: StoredScans) -> None:
    """Write the table. Raises OSError."""
    scans, count = sighted.scans, len(sighted.scans)
    stamps = np.array([scan.stamp for scan in scans])
    hung_stamps, anchors, relative, informations = sighted.path.hung()
    placed = _rows_of(hung_stamps, stamps)
    keyframes = _rows_of(np.array(sighted.keyframe_stamps), stamps)
    columns: dict[str, NDArray[np.generic] | Ragged] = {"stamp": stamps}
    odometry = np.array([scan.odometry for scan in scans]).reshape(-1, 3)
    columns |= {f"odometry_{name}": odometry[:, k] for k, name in enumerate(("x", "y", "heading"))}
    columns["keyframe"] = _at(keyframes, np.arange(len(keyframes)), count, -1).astype(np.int32)
    columns["anchor"] = _at(placed, anchors, count, -1).astype(np.int32)
    for k, name in enumerate(("x", "y", "heading")):
        columns[f"relative_{name}"] = _at(placed, relative[:, k], count, 0.0)
    upper = informations[:, UPPER[0], UPPER[1]]
    for k, name in enumerate(INFORMATION):
        columns[f"information_{name}"] = _at(placed, upper[:, k], count, 0.0)
    columns["seen"] = np.array([scan.features is not NO_FEATURES for scan in scans], dtype=bool)
    columns |= _features([scan.features for scan in scans], exact=False)
    none = np.zeros(0, dtype=np.int64)
    walls, corners = [none] * count, [none] * count
    for row, names in zip(keyframes, sighted.names, strict=True):
        walls[row], corners[row] = names.walls, names.corners
    columns["names_walls"], columns["names_corners"] = ragged(walls, np.int32), ragged(corners, np.int32)
    write_table(file, columns)


def _rows_of(some: Floats, stamps: Floats) -> Integers:
    """Rows of the stamps that are these, both in time order; where a stamp is there twice, each is taken once."""
    rows, row = np.zeros(len(some), dtype=np.int64), 0
    for k, stamp in enumerate(some.tolist()):
        while stamps[row] != stamp:
            row += 1
        rows[k] = row
        row += 1
    return rows


def _at(rows: Integers, values: NDArray[np.generic], count: int, elsewhere: float) -> NDArray[np.generic]:
    column = np.full(count, elsewhere, dtype=values.dtype if len(values) else type(elsewhere))
    column[rows] = values
    return column


def write_recent(file: Path, sighted: StoredScans) -> None:
    """Write the table of what the last keyframes saw. Raises OSError."""
    rows = _rows_of(np.array(sighted.keyframe_stamps), np.array([some.stamp for some in sighted.scans]))[-RECENT:]
    seen = [sighted.scans[row].features for row in rows.tolist()]
    write_table(file, {"row": rows.astype(np.int32), **_features(seen, exact=True)})


def _features(seen: Sequence[ScanFeatures], *, exact: bool) -> dict[str, Ragged]:
    """The columns; `exact` to the last bit."""
    number = np.float64 if exact else np.float32
    columns: dict[str, Ragged] = {}
    segments = [
        np.column_stack([s.frame, s.half_length, s.covariance[:, [0, 0, 1], [0, 1, 1]]])
        for s in (some.segments for some in seen)
    ]
    for k, name in enumerate(SEGMENT):
        columns[f"segment_{name}"] = ragged([some[:, k] for some in segments], number)
    corners = [
        np.column_stack([c.position, c.covariance[:, [0, 0, 1], [0, 1, 1]]]) for c in (some.corners for some in seen)
    ]
    for k, name in enumerate(CORNER):
        columns[f"corner_{name}"] = ragged([some[:, k] for some in corners], number)
    for k, name in enumerate(("before", "after")):
        columns[f"corner_{name}"] = ragged([some.corners.segments[:, k] for some in seen], np.int32)
    for kind in ("all", "loose"):
        points = [getattr(some.points, kind) for some in seen]
        for k, name in enumerate(("x", "y")):
            column = ragged([some[:, k] for some in points], np.float64)
            columns[f"{kind}_{name}"] = column if exact else _in_units(column)
    return columns


def _in_units(column: Ragged) -> Ragged:
    counts = np.rint(column.values / POINT_UNIT).clip(-FARTHEST, FARTHEST)
    return Ragged(counts.astype(np.int32), column.lengths)


def read_scans(file: Path, recent: Path) -> StoredScans:
    """Read both tables. Raises MapError naming the file."""
    table = Columns(file)
    stamps, odometry = table.floats("stamp"), table.floats("odometry_x", "odometry_y", "odometry_heading")
    seen = _read_features(table, file, exact=False)
    latest = Columns(recent)
    for row, some in zip(latest.integers("row").tolist(), _read_features(latest, recent, exact=True), strict=True):
        if not 0 <= row < len(seen) or len(some.segments) != len(seen[row].segments):
            raise MapError(f"{recent}: is not of the same session as {file.name}")
        seen[row] = some
    kept = table.flags("seen")
    scans = [
        ProcessedScan(float(stamps[row]), odometry[row], seen[row] if kept[row] else NO_FEATURES)
        for row in range(len(table))
    ]
    keyframe, anchor = table.integers("keyframe"), table.integers("anchor")
    rows = np.flatnonzero(keyframe >= 0)
    if not np.array_equal(keyframe[rows], np.arange(len(rows))) or (anchor >= len(rows)).any():
        raise MapError(f"{file}: the keyframes are not in order")
    relative = table.floats("relative_x", "relative_y", "relative_heading")
    upper = table.floats(*(f"information_{name}" for name in INFORMATION))
    informations = np.zeros((len(table), 3, 3))
    informations[:, UPPER[0], UPPER[1]] = informations[:, UPPER[1], UPPER[0]] = upper
    path = TrajectoryBuilder()
    for row in np.flatnonzero(anchor >= 0).tolist():
        path.add(float(stamps[row]), int(anchor[row]), relative[row], informations[row])
    walls, corners = (_split(*table.ragged_integers(name)) for name in ("names_walls", "names_corners"))
    names = [LandmarkIds(walls[row][:, 0], corners[row][:, 0]) for row in rows.tolist()]
    for row, named in zip(rows.tolist(), names, strict=True):
        if len(named.walls) != len(seen[row].segments) or len(named.corners) != len(seen[row].corners):
            raise MapError(f"{file}: a keyframe does not say what each thing that it sees is")
    return StoredScans(scans, path, stamps[rows].tolist(), names)


def _split(values: NDArray[Number], lengths: Integers) -> list[NDArray[Number]]:
    """The values of each row."""
    return np.split(values, np.cumsum(lengths)[:-1]) if len(lengths) else []


def _read_features(table: Columns, file: Path, *, exact: bool) -> list[ScanFeatures]:
    segments = _split(*table.ragged_floats(*(f"segment_{name}" for name in SEGMENT)))
    corners = _split(*table.ragged_floats(*(f"corner_{name}" for name in CORNER)))
    pairs = _split(*table.ragged_integers("corner_before", "corner_after"))
    every, loose = (_read_points(table, kind, exact=exact) for kind in ("all", "loose"))
    seen, tidy = [], np.ascontiguousarray  # compiled code is for arrays without gaps
    for row in range(len(table)):
        frame = tidy(segments[row][:, :3])
        if len(pairs[row]) != len(corners[row]) or not ((pairs[row] >= 0) & (pairs[row] < len(frame))).all():
            raise MapError(f"{file}: a corner is of walls that are not there")
        seen.append(
            ScanFeatures(
                Segments(frame, tidy(segments[row][:, 3]), tidy(segments[row][:, [4, 5, 5, 6]]).reshape(-1, 2, 2)),
                CornerPoints(
                    tidy(corners[row][:, :2]),
                    tidy(corners[row][:, [2, 3, 3, 4]]).reshape(-1, 2, 2),
                    pairs[row],
                    frame[pairs[row], 2].reshape(-1, 2),
                ),
                ScanPoints(every[row], loose[row]),
            )
        )
    return seen


def _read_points(table: Columns, kind: str, *, exact: bool) -> list[Floats]:
    names = f"{kind}_x", f"{kind}_y"
    if exact:
        return _split(*table.ragged_floats(*names))
    counts, lengths = table.ragged_integers(*names)
    return _split(POINT_UNIT * counts.astype(np.float64), lengths)
