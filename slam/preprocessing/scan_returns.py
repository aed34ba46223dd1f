"""Points of a scan in the base's frame, and which of them lie on no line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined

from ..matching.scan_points import MAX_SCAN_POINTS, ScanPoints, subsample
from .deskew import DeskewedScan

if TYPE_CHECKING:
    from features.types import Lines

# Metres from the continuation of a line within which a point may belong to the same wall. Origin: chosen; not measured.
LINE_DISTANCE = 0.05
# Half lengths of a line, from its middle, up to which its continuation reaches: as much again on either side.
# Origin: chosen; not measured.
CONTINUATION = 3.0


def scan_returns(scan: DeskewedScan, lines: Lines, mount: se2.Pose) -> ScanPoints:
    """Return the points of a scan in the base's frame: all valid returns, and those on no line or continuation of one.

    `mount` is the pose of the lidar, in whose frame the `lines` of the scan are. Of many points, every k-th is
    returned, see MAX_SCAN_POINTS. The last returns from a corridor's walls move with the robot, so they must not count
    as loose points.
    """
    # copies, as read-only arrays and columns of a table would be compiled for separately
    ranges, bearings = scan.ranges.copy(), scan.bearings.copy()
    first, last, start, end = (array.copy() for array in (lines.first, lines.last, lines.start, lines.end))
    returns = _returns(ranges, bearings, first, last, start, end, tuple(mount.tolist()))
    return ScanPoints(*(subsample(points, MAX_SCAN_POINTS) for points in returns))


@compiled
def _returns(ranges, bearings, first, last, start, end, mount):  # type: ignore[no-untyped-def]
    """Return all points (p, 2) in the base's frame, and those on no line; for the arguments see `scan_returns`."""
    on_line = np.zeros(len(ranges), np.bool_)
    for j in range(len(first)):
        if first[j] <= last[j]:
            on_line[first[j] : last[j] + 1] = True
        else:  # over the end of a full revolution
            on_line[first[j] :] = True
            on_line[: last[j] + 1] = True
    every, loose, count, loose_count = np.empty((len(ranges), 2)), np.empty((len(ranges), 2)), 0, 0
    c, s = math.cos(mount[2]), math.sin(mount[2])
    for k in range(len(ranges)):
        if not np.isfinite(ranges[k]):
            continue
        x, y = ranges[k] * math.cos(bearings[k]), ranges[k] * math.sin(bearings[k])
        every[count, 0], every[count, 1] = mount[0] + c * x - s * y, mount[1] + s * x + c * y
        if not on_line[k] and not _is_on_continuation(x, y, start, end):
            loose[loose_count] = every[count]
            loose_count += 1
        count += 1
    return every[:count], loose[:loose_count]


@inlined
def _is_on_continuation(x, y, start, end):  # type: ignore[no-untyped-def]
    """True if a point lies on the continuation of a line, which is as long again on either side."""
    for j in range(len(start)):
        half_x, half_y = 0.5 * (end[j, 0] - start[j, 0]), 0.5 * (end[j, 1] - start[j, 1])
        dx, dy = x - 0.5 * (start[j, 0] + end[j, 0]), y - 0.5 * (start[j, 1] + end[j, 1])
        length = math.hypot(half_x, half_y)
        along, across = (dx * half_x + dy * half_y) / length, (half_x * dy - half_y * dx) / length
        if abs(across) < LINE_DISTANCE and abs(along) < CONTINUATION * length:
            return True
    return False
