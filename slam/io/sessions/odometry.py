"""Write and read the odometry of a session: a row for each reading, with the number of its odometry segment."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from ...bounds import MAX_MAGNITUDE
from ...errors import MapError
from ...geometry.segments import Floats
from ...odometry.history import OdometryHistory
from .tables import POSE_COLUMNS, Column, TableReader, write_row_groups


def write_odometry(file: Path, histories: Sequence[OdometryHistory]) -> None:
    """Write the odometry of all segments, a block at a time: all at once would need several times the memory of the
    run's own record. Raises OSError.
    """
    blocks = ((k, *block) for k, history in enumerate(histories) for block in history.blocks())
    first = next(blocks, (0, np.zeros(0), np.zeros((0, 3))))
    write_row_groups(file, (_columns(*block) for block in chain([first], blocks)))


def _columns(segment: int, stamps: Floats, poses: Floats) -> dict[str, Column]:
    """Return the columns of readings (n,) of one segment."""
    columns: dict[str, Column] = {"segment": np.full(len(stamps), segment, dtype=np.int32), "stamp": stamps}
    return columns | {name: poses[:, k] for k, name in enumerate(POSE_COLUMNS)}


def read_odometry(file: Path) -> list[OdometryHistory]:
    """Read the odometry of each segment. Raises MapError naming the file."""
    table = TableReader(file)
    segment, stamps = table.integers("segment"), table.floats("stamp", limit=MAX_MAGNITUDE)
    poses = table.floats(*POSE_COLUMNS)
    if (np.diff(segment) < 0).any() or (np.diff(stamps) <= 0).any():
        raise MapError(f"{file}: the readings are not in time order")
    return [OdometryHistory.from_arrays(stamps[segment == k], poses[segment == k]) for k in np.unique(segment).tolist()]
