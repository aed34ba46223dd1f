"""Write and read the odometry of a session: a row for each reading, with the number of its odometry segment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import MapError
from ...odometry.history import OdometryHistory
from .tables import TableReader, write_table

POSE_COLUMNS = ("x", "y", "heading")


def write_odometry(file: Path, histories: Sequence[OdometryHistory]) -> None:
    """Write the odometry of all segments. Raises OSError."""
    stamps = np.concatenate([np.zeros(0), *(history.stamps for history in histories)])
    poses = np.concatenate([np.zeros((0, 3)), *(history.poses for history in histories)])
    segment = np.repeat(np.arange(len(histories), dtype=np.int32), [len(history) for history in histories])
    write_table(
        file, {"segment": segment, "stamp": stamps, **{name: poses[:, k] for k, name in enumerate(POSE_COLUMNS)}}
    )


def read_odometry(file: Path) -> list[OdometryHistory]:
    """Read the odometry of each segment. Raises MapError naming the file."""
    table = TableReader(file)
    segment, stamps, poses = table.integers("segment"), table.floats("stamp"), table.floats(*POSE_COLUMNS)
    if (np.diff(segment) < 0).any() or (np.diff(stamps) <= 0).any():
        raise MapError(f"{file}: the readings are not in time order")
    return [OdometryHistory.from_arrays(stamps[segment == k], poses[segment == k]) for k in np.unique(segment).tolist()]
