"""Write a point cloud as binary PLY (Stanford polygon format), as CloudCompare, MeshLab and Open3D read it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from .scan_placement import PlacedScan

HEADER = (
    "ply\n"
    "format binary_little_endian 1.0\n"
    "comment metres in the frame map\n"
    "element vertex {count:0>12}\n"
    "property float x\n"
    "property float y\n"
    "property float z\n"
    "end_header\n"
)
"""The number of points has a fixed width, since it is filled in after all points are written."""


def write_ply(path: Path, scans: Iterable[PlacedScan]) -> int:
    """Write all points of all scans with z = 0, in constant memory, and return their number."""
    count = 0
    with path.open("wb") as file:
        file.write(HEADER.format(count=0).encode("ascii"))
        for scan in scans:
            rows = np.zeros((len(scan.points), 3), dtype="<f4")
            rows[:, :2] = scan.points
            file.write(rows.tobytes())
            count += len(rows)
        file.seek(0)
        file.write(HEADER.format(count=count).encode("ascii"))
    return count
