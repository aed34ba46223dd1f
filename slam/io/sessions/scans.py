"""Write and read the scans of a session: features, odometry, and poses relative to keyframes, a row for each scan.

Features are stored with reduced precision, see `scan_features`. The features of the last keyframes are stored a second
time, exactly, in a table of their own: the next scans are matched to them, and continuing a session has to give the
same estimate as an uninterrupted run.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

from ...bounds import MAX_MAGNITUDE
from ...errors import MapError
from ...geometry.segments import Floats, Integers
from ...mapping.keyframes import LandmarkIds
from ...mapping.mapped_keyframes import MAX_RECENT_SEGMENTS
from ...mapping.trajectory_builder import TrajectoryBuilder
from ...matching.scan_features import ScanFeatures
from ...preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from ...preprocessing.scan_sequence import ScanSequence
from .scan_features import UPPER_TRIANGLE, are_rounded_from, feature_columns, read_features, split_rows
from .tables import (
    POSE_COLUMNS,
    Column,
    Ragged,
    TableReader,
    are_semidefinite,
    to_ragged,
    write_row_groups,
    write_table,
)

EXACT_KEYFRAMES = MAX_RECENT_SEGMENTS
"""Last keyframes whose features are stored exactly: all that are used online."""
GROUP_ROWS = 1000
"""Scans of which the features are written at once: some megabytes."""
POSE_ENTRIES = ("xx", "xy", "xh", "yy", "yh", "hh")
"""Names of the upper triangle's entries of a matrix of (x, y, heading)."""
MEASURED = "measured"
SEGMENT_IDS, CORNER_IDS = "segment_landmark_ids", "corner_landmark_ids"


@immutable
class ScanRecords:
    """All scans of a session, the trajectory through them, and the keyframes among them.

    keyframe_stamps  of each keyframe: stamp of its scan, seconds
    landmark_ids     of each keyframe: landmarks that its segments and corners are associated with
    """

    scans: ScanSequence
    trajectory: TrajectoryBuilder
    keyframe_stamps: list[float]
    landmark_ids: list[LandmarkIds]


def write_scans(file: Path, records: ScanRecords) -> None:
    """Write the table, the columns of a group at a time. Raises OSError."""
    count = len(records.scans)
    keyframes = _rows_of(np.array(records.keyframe_stamps), records.scans.stamps)
    values = _Values.of(records)
    ends = [*range(GROUP_ROWS, count, GROUP_ROWS), count]
    groups = (range(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
    write_row_groups(
        file,
        (
            dict[str, Column](values.columns(keyframes, rows)) | _columns_of_lists(records, keyframes, rows)
            for rows in groups
        ),
    )


@immutable
class _Values:
    """Values of all n scans, of which m have a pose on the trajectory.

    stamps, travel, measured, has_features  (n,), odometry (n, 3): see `ScanSequence`
    tracked        (m,) rows of the scans on the trajectory
    own_keyframes  (m,), relative (m, 3), informations (m, 3, 3): see `TrajectoryBuilder`
    """

    stamps: Floats
    odometry: Floats
    travel: Floats
    measured: NDArray[np.bool_]
    has_features: NDArray[np.bool_]
    tracked: Integers
    own_keyframes: Integers
    relative: Floats
    informations: Floats

    @classmethod
    def of(cls, records: ScanRecords) -> _Values:
        """Return the values of the scans of a session."""
        scans, stamps = records.scans, records.scans.stamps
        tracked_stamps, own, relative, informations = records.trajectory.relative_poses()
        tracked = _rows_of(tracked_stamps, stamps)
        return cls(
            stamps,
            scans.odometry,
            scans.travel,
            scans.measured,
            scans.has_features,
            tracked,
            own,
            relative,
            informations,
        )

    def columns(self, keyframes: Integers, rows: range) -> dict[str, NDArray[np.generic]]:
        """Return the columns with one value for each of the scans `rows`; `keyframes` are the rows of keyframes."""
        some, count = slice(rows.start, rows.stop), len(rows)
        first, last = np.searchsorted(keyframes, [rows.start, rows.stop]).tolist()
        begin, end = np.searchsorted(self.tracked, [rows.start, rows.stop]).tolist()
        tracked = self.tracked[begin:end] - rows.start
        columns: dict[str, NDArray[np.generic]] = {"stamp": self.stamps[some]}
        columns |= {f"odometry_{name}": self.odometry[some, k] for k, name in enumerate(POSE_COLUMNS)}
        columns |= {"sweep_travel": self.travel[some], MEASURED: self.measured[some]}
        numbers = _scatter(keyframes[first:last] - rows.start, np.arange(first, last), count, -1)
        columns["keyframe"] = numbers.astype(np.int32)
        columns["anchor"] = _scatter(tracked, self.own_keyframes[begin:end], count, -1).astype(np.int32)
        for k, name in enumerate(POSE_COLUMNS):
            columns[f"relative_{name}"] = _scatter(tracked, self.relative[begin:end, k], count, 0.0)
        for i, j, name in zip(*UPPER_TRIANGLE, POSE_ENTRIES, strict=True):
            columns[f"information_{name}"] = _scatter(tracked, self.informations[begin:end, i, j], count, 0.0)
        return columns | {"has_features": self.has_features[some]}


def _columns_of_lists(records: ScanRecords, keyframes: Integers, rows: range) -> dict[str, Ragged]:
    """Return the columns with any number of values for each scan, of the scans `rows`; `keyframes` as above."""
    scans = records.scans
    with_features = np.flatnonzero(scans.has_features[rows.start : rows.stop])
    features = feature_columns([scans.features(rows[row]) for row in with_features.tolist()], exact=False)
    columns = {name: _spread(column, with_features, len(rows)) for name, column in features.items()}
    first, last = np.searchsorted(keyframes, [rows.start, rows.stop]).tolist()
    for name, ids in (
        (SEGMENT_IDS, [ids.walls for ids in records.landmark_ids[first:last]]),
        (CORNER_IDS, [ids.corners for ids in records.landmark_ids[first:last]]),
    ):
        columns[name] = _spread(to_ragged(ids, np.int32), keyframes[first:last] - rows.start, len(rows))
    return columns


def _spread(column: Ragged, rows: Integers, count: int) -> Ragged:
    """Return a column of `count` rows with the values of another one at `rows`, and no values elsewhere."""
    lengths = np.zeros(count, dtype=np.int64)
    lengths[rows] = column.lengths
    return Ragged(column.values, lengths)


def _rows_of(some: Floats, stamps: Floats) -> Integers:
    """Return the rows of `stamps` that hold `some`; both are sorted, and equal stamps are matched one to one."""
    among_equal = np.arange(len(some)) - np.searchsorted(some, some)
    return np.searchsorted(stamps, some) + among_equal


def _scatter(rows: Integers, values: NDArray[np.generic], count: int, default: float) -> NDArray[np.generic]:
    """Return a column (count,) with `values` at `rows` and `default` elsewhere."""
    column = np.full(count, default, dtype=values.dtype if len(values) else type(default))
    column[rows] = values
    return column


def write_recent_keyframes(file: Path, records: ScanRecords) -> None:
    """Write the exact features of the last keyframes. Raises OSError."""
    rows = _rows_of(np.array(records.keyframe_stamps), records.scans.stamps)[-EXACT_KEYFRAMES:]
    features = [records.scans.features(row) for row in rows.tolist()]
    write_table(file, {"row": rows.astype(np.int32), **feature_columns(features, exact=True)})


def read_scans(file: Path, recent_keyframes: Path) -> ScanRecords:
    """Read both tables. Raises MapError naming the file."""
    table = TableReader(file)
    stamps = table.floats("stamp", limit=MAX_MAGNITUDE)
    if (np.diff(stamps) < 0.0).any():
        raise MapError(f"{file}: the scans are not in time order")
    odometry = table.floats("odometry_x", "odometry_y", "odometry_heading")
    features = read_features(table, file, exact=False)
    keyframe, own_keyframes = table.integers("keyframe"), table.integers("anchor")
    rows = np.flatnonzero(keyframe >= 0)
    if not np.array_equal(keyframe[rows], np.arange(len(rows))):
        raise MapError(f"{file}: the keyframes are not in order")
    if (own_keyframes > np.maximum.accumulate(keyframe)).any():
        raise MapError(f"{file}: the pose of a scan is relative to a later keyframe")
    _read_recent_keyframes(recent_keyframes, features, rows[-EXACT_KEYFRAMES:])
    has_features = table.booleans("has_features")
    travel = table.floats("sweep_travel").tolist()
    measured = table.booleans(MEASURED) if MEASURED in table else np.ones(len(table), dtype=bool)  # by earlier versions
    features = [one if has_features[row] else NO_FEATURES for row, one in enumerate(features)]
    scans = ScanSequence(
        ProcessedScan(float(stamps[row]), odometry[row], features[row], travel[row], bool(measured[row]))
        for row in range(len(table))
    )
    walls, corners = (split_rows(*table.ragged_integers(name)) for name in (SEGMENT_IDS, CORNER_IDS))
    landmark_ids = [LandmarkIds(walls[row][:, 0], corners[row][:, 0]) for row in rows.tolist()]
    for row, ids in zip(rows.tolist(), landmark_ids, strict=True):
        if len(ids.walls) != len(features[row].segments) or len(ids.corners) != len(features[row].corners):
            raise MapError(f"{file}: a keyframe does not have a landmark id for each feature")
    return ScanRecords(scans, _read_trajectory(table, file, stamps, own_keyframes), stamps[rows].tolist(), landmark_ids)


def _read_recent_keyframes(file: Path, features: list[ScanFeatures], rows: Integers) -> None:
    """Replace the features of the last keyframes, which are at `rows`, by the exact ones."""
    table = TableReader(file)
    exact = read_features(table, file, exact=True)
    belongs = np.array_equal(table.integers("row"), rows)
    if not belongs or not are_rounded_from([features[row] for row in rows.tolist()], exact):
        raise MapError(f"{file}: does not belong to the same session as the table of scans")
    for row, one in zip(rows.tolist(), exact, strict=True):
        features[row] = one


def _read_trajectory(table: TableReader, file: Path, stamps: Floats, own_keyframes: Integers) -> TrajectoryBuilder:
    """Read the poses of the scans relative to their own keyframes, -1 without one. Raises MapError naming the file."""
    relative = table.floats("relative_x", "relative_y", "relative_heading")
    upper = table.floats(*(f"information_{name}" for name in POSE_ENTRIES), limit=MAX_MAGNITUDE)
    informations = np.zeros((len(table), 3, 3))
    informations[:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]] = upper
    informations[:, UPPER_TRIANGLE[1], UPPER_TRIANGLE[0]] = upper
    if not are_semidefinite(informations):
        raise MapError(f"{file}: the information of a pose is negative")
    rows = own_keyframes >= 0
    return TrajectoryBuilder.from_arrays(stamps[rows], own_keyframes[rows], relative[rows], informations[rows])
