"""Write and read the keyframes of a session: pose, covariance, travelled distance and correlated drift of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...bounds import MAX_MAGNITUDE
from ...errors import MapError
from ...geometry.segments import Floats
from ...mapping.keyframes import KeyframeRecords
from .scan_features import UPPER_TRIANGLE
from .scans import POSE_ENTRIES, ScanRecords
from .tables import POSE_COLUMNS, TableReader, are_semidefinite, write_table

CORRELATED_DRIFT = {"correlated_drift_xx": (0, 0), "correlated_drift_xy": (0, 1), "correlated_drift_yy": (1, 1)}
"""Columns of the correlated drift's covariance (2, 2), and their row and column in it."""


FARTHER, NEAR = 10.0, 1e3
"""Ratio of distances, and metres: the robot is not farther from the first keyframe than that of the driven distance,
and so much more. Odometry may have measured less of a drive, and parts of a map may be apart.
"""


def are_reachable(positions: Floats, first: Floats, travelled: Sequence[float]) -> bool:
    """Return True if the robot can have been at all positions (n, 2) in the map.

    first      (2,) position of the first keyframe
    travelled  metres driven up to each keyframe
    """
    return bool((np.hypot(*(positions - first).T) <= NEAR + FARTHER * travelled[-1]).all())


def write_keyframes(file: Path, stamps: Sequence[float], records: KeyframeRecords) -> None:
    """Write the table. Raises OSError."""
    upper = records.covariances[:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]]
    columns = {"stamp": np.array(stamps)}
    columns |= {name: records.keyframe_poses[:, k] for k, name in enumerate(POSE_COLUMNS)}
    columns["travelled"] = np.array(records.travelled[: len(stamps)])
    columns |= {name: upper[:, k] for k, name in enumerate(POSE_ENTRIES)}
    columns |= {name: records.correlated_drift[:, row, column] for name, (row, column) in CORRELATED_DRIFT.items()}
    write_table(file, columns)


def read_keyframes(file: Path, scans: ScanRecords) -> KeyframeRecords:
    """Read the table; stamps and landmark ids must be those of `scans`. Raises MapError naming the file."""
    table = TableReader(file)
    if not np.array_equal(table.floats("stamp", limit=MAX_MAGNITUDE), scans.keyframe_stamps):
        raise MapError(f"{file}: the keyframes are not those of the table of scans")
    upper = table.floats(*POSE_ENTRIES, limit=MAX_MAGNITUDE)
    covariances = np.zeros((len(table), 3, 3))
    covariances[:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]] = upper
    covariances[:, UPPER_TRIANGLE[1], UPPER_TRIANGLE[0]] = upper
    if not are_semidefinite(covariances):
        raise MapError(f"{file}: the covariance of a pose has a negative variance")
    travelled = table.floats("travelled", limit=MAX_MAGNITUDE).tolist()
    if (np.diff(travelled, prepend=0.0) < 0.0).any():
        raise MapError(f"{file}: the travelled distance decreases")
    poses = table.floats(*POSE_COLUMNS)
    if len(poses) and not are_reachable(poses[:, :2], poses[0, :2], travelled):
        raise MapError(f"{file}: a keyframe is farther away than the robot can have driven")
    if not are_reachable(scans.trajectory.relative_poses()[2][:, :2], np.zeros(2), travelled or [0.0]):
        raise MapError(f"{file}: a scan is farther from its keyframe than the robot can have driven")
    correlated_drift = np.zeros((len(table), 2, 2))
    for name, (row, column) in CORRELATED_DRIFT.items():
        correlated_drift[:, row, column] = correlated_drift[:, column, row] = table.floats(name)
    return KeyframeRecords(poses, travelled or [0.0], scans.landmark_ids, covariances, correlated_drift)
