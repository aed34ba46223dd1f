"""Write and read the last scans of a run, as measured, if it ended before odometry covered their sweep."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.messages import Scan

from ...bounds import MAX_MAGNITUDE
from ...errors import MapError
from .tables import TableReader, to_ragged, write_table

BEAM_COLUMNS = ("range", "angle", "time_offset")
SCAN_COLUMNS = ("stamp", "range_min", "range_max")
MOUNT_COLUMNS = ("mount_x", "mount_y", "mount_heading")
LIDAR_COLUMN = "lidar"


def write_queued_scans(file: Path, scans: Sequence[Scan]) -> None:
    """Write the table. NaN stands for the range of a no-return and for an unknown mount. Raises OSError."""
    unknown = np.full(3, np.nan)
    mounts = np.array([unknown if scan.mount is None else scan.mount for scan in scans]).reshape(-1, 3)
    write_table(
        file,
        {
            **{name: np.array([getattr(scan, name) for scan in scans], dtype=np.float64) for name in SCAN_COLUMNS},
            **{name: mounts[:, k] for k, name in enumerate(MOUNT_COLUMNS)},
            LIDAR_COLUMN: np.array([scan.lidar for scan in scans], dtype=np.int64),
            "range": to_ragged([scan.ranges for scan in scans], np.float64),
            "angle": to_ragged([scan.angles for scan in scans], np.float64),
            "time_offset": to_ragged([scan.time_offsets for scan in scans], np.float64),
        },
    )


def read_queued_scans(file: Path) -> list[Scan]:
    """Read the table. Raises MapError naming the file."""
    table = TableReader(file)
    mounts = table.floats(*MOUNT_COLUMNS, finite=False)
    stamps, range_min, range_max = (
        table.floats(name, finite=name == "stamp", limit=MAX_MAGNITUDE) for name in SCAN_COLUMNS
    )
    beams, lengths = table.ragged_floats(*BEAM_COLUMNS, finite=False)
    if not np.isfinite(beams[:, 1:]).all():
        raise MapError(f"{file}: the angle or time of a beam is not finite")
    lidars = table.integers(LIDAR_COLUMN) if LIDAR_COLUMN in table else np.zeros(len(table), dtype=np.int64)
    if not np.isin(lidars, (0, 1)).all():
        raise MapError(f"{file}: there is no such lidar")
    ends = np.concatenate([[0], np.cumsum(lengths)])
    scans = []
    for row in range(len(table)):
        ranges, angles, offsets = np.ascontiguousarray(beams[ends[row] : ends[row + 1]].T)
        mount = mounts[row] if np.isfinite(mounts[row]).all() else None
        limits = float(range_min[row]), float(range_max[row])
        scans.append(Scan(float(stamps[row]), ranges, angles, offsets, *limits, mount, int(lidars[row])))
    return scans
