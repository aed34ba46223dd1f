"""Write and read the keyframes of a session: pose, covariance, travelled distance and correlated drift of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import MapError
from ...mapping.keyframes import KeyframeRecords
from .scans import POSE_ENTRIES, UPPER_TRIANGLE, ScanRecords
from .tables import TableReader, are_semidefinite, write_table

POSE_COLUMNS = ("x", "y", "heading")
CORRELATED_DRIFT = {"correlated_drift_xx": (0, 0), "correlated_drift_xy": (0, 1), "correlated_drift_yy": (1, 1)}
"""Columns of the correlated drift's covariance (2, 2), and their row and column in it."""


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
    if not np.array_equal(table.floats("stamp"), scans.keyframe_stamps):
        raise MapError(f"{file}: the keyframes are not those of the table of scans")
    upper = table.floats(*POSE_ENTRIES)
    covariances = np.zeros((len(table), 3, 3))
    covariances[:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]] = upper
    covariances[:, UPPER_TRIANGLE[1], UPPER_TRIANGLE[0]] = upper
    if not are_semidefinite(covariances):
        raise MapError(f"{file}: the covariance of a pose has a negative variance")
    travelled = table.floats("travelled").tolist()
    if (np.diff(travelled, prepend=0.0) < 0.0).any():
        raise MapError(f"{file}: the travelled distance decreases")
    correlated_drift = np.zeros((len(table), 2, 2))
    for name, (row, column) in CORRELATED_DRIFT.items():
        correlated_drift[:, row, column] = correlated_drift[:, column, row] = table.floats(name)
    return KeyframeRecords(
        table.floats(*POSE_COLUMNS), travelled or [0.0], scans.landmark_ids, covariances, correlated_drift
    )
