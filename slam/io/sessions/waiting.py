"""The last scans of a run, as they were measured, for which odometry had not come yet when it ended."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.messages import Scan

from ...errors import MapError
from .tables import Columns, ragged, write_table

RAYS = ("range", "angle", "time_offset")
LIMITS = ("stamp", "range_min", "range_max")
MOUNT = ("mount_x", "mount_y", "mount_heading")


def write_waiting(file: Path, scans: Sequence[Scan]) -> None:
    """Write the table; NaN stands for a range without return, and for a mount that is not known. Raises OSError."""
    unknown = np.full(3, np.nan)
    mounts = np.array([unknown if scan.mount is None else scan.mount for scan in scans]).reshape(-1, 3)
    write_table(
        file,
        {
            **{name: np.array([getattr(scan, name) for scan in scans], dtype=np.float64) for name in LIMITS},
            **{name: mounts[:, k] for k, name in enumerate(MOUNT)},
            "range": ragged([scan.ranges for scan in scans], np.float64),
            "angle": ragged([scan.angles for scan in scans], np.float64),
            "time_offset": ragged([scan.time_offsets for scan in scans], np.float64),
        },
    )


def read_waiting(file: Path) -> list[Scan]:
    """Read the table. Raises MapError naming the file."""
    table = Columns(file)
    mounts = table.floats(*MOUNT, finite=False)
    stamps, nearest, farthest = (table.floats(name, finite=name == "stamp") for name in LIMITS)
    rays, lengths = table.ragged_floats(*RAYS, finite=False)
    if not np.isfinite(rays[:, 1:]).all():
        raise MapError(f"{file}: a ray has no direction or no time")
    ends = np.concatenate([[0], np.cumsum(lengths)])
    scans = []
    for row in range(len(table)):
        ranges, angles, offsets = np.ascontiguousarray(rays[ends[row] : ends[row + 1]].T)
        mount = mounts[row] if np.isfinite(mounts[row]).all() else None
        scans.append(
            Scan(float(stamps[row]), ranges, angles, offsets, float(nearest[row]), float(farthest[row]), mount)
        )
    return scans
