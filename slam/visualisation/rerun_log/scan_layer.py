"""Draw scans of past keyframes behind the map: those of the last keyframes, and on request those of the whole drive."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from drivers import se2

from ...geometry.segments import Floats
from ...io.exports import PlacedScan
from . import colours
from .rrd_writer import RrdWriter
from .shapes import SCAN_STEPS, Float32s, Height, to_3d

LAST_SCANS = 5  # keyframes
CELL = 0.1  # metres; one point is kept in each cell
BLOCK_SIZE = 20  # keyframes whose scans are one entity
RANGE = 5.0  # metres
MAX_DEVIATION = 0.05  # metres by which points at RANGE may differ from where they are drawn

_POINT_SIZE = rr.Radius.ui_points(0.8)


class ScanLayer:
    """Thinned scans in the map frame: `world/last_scans` and `world/scans`."""

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        self._scans: list[Float32s] = []  # thinned, in the frames of the keyframes
        self._drawn: list[Floats] = []  # poses (n, 3) with which each block was drawn
        self._last: dict[int, Floats] = {}  # pose with which the scan of each of the last keyframes was drawn
        for place in range(LAST_SCANS):
            writer.log_static(f"world/last_scans/{place}", _style())

    def add(self, index: int, pose: se2.Pose, points: Floats) -> None:
        """Draw the scan of a new keyframe, `points` (p, 2) in its frame, in place of the oldest of the last scans."""
        self._scans += [np.empty((0, 2), dtype=np.float32)] * (index + 1 - len(self._scans))
        self._scans[index] = thinned(points)
        self._log_last(index, pose)

    def _log_last(self, index: int, pose: se2.Pose) -> None:
        self._last[index] = pose
        self._last.pop(index - LAST_SCANS, None)
        positions = to_3d(se2.transform(pose, self._scans[index]), Height.BACKDROP, SCAN_STEPS)
        self._writer.log_batched(f"world/last_scans/{index % LAST_SCANS}", rr.Points3D, positions=positions)

    def placed(self, keyframes: Floats) -> Iterator[PlacedScan]:
        """Yield the thinned scans of keyframes at poses (k, 3), as if the lidar were in the middle of the base."""
        for pose, scan in zip(keyframes, self._scans, strict=False):
            yield PlacedScan(0.0, pose[:2], se2.transform(pose, scan.astype(np.float64)))

    def log_all(self, keyframes: Floats) -> None:
        """Draw the scans of the keyframes (k, 3) in blocks; those that have neither grown nor moved remain."""
        count = min(len(keyframes), len(self._scans))
        for index, pose in list(self._last.items()):
            if index < count and _deviation(pose[None], keyframes[index][None]) > MAX_DEVIATION:
                self._log_last(index, keyframes[index])
        for number, first in enumerate(range(0, count, BLOCK_SIZE)):
            poses = keyframes[first : min(first + BLOCK_SIZE, count)]
            if number == len(self._drawn):
                self._writer.log_static(f"world/scans/{number}", _style())
                self._drawn.append(np.empty((0, 3)))
            if len(poses) == len(self._drawn[number]) and _deviation(self._drawn[number], poses) < MAX_DEVIATION:
                continue
            self._drawn[number] = poses.copy()
            scans = self._scans[first : first + len(poses)]
            placed = [se2.transform(pose, scan) for pose, scan in zip(poses, scans, strict=True)]
            positions = to_3d(thinned(np.concatenate(placed)), Height.BACKDROP, SCAN_STEPS)
            self._writer.log(f"world/scans/{number}", rr.Points3D.from_fields(positions=positions))


def thinned(points: Floats) -> Float32s:
    """Return the first of the points (p, 2) in each cell of a grid."""
    x, y = np.floor(points / CELL).astype(np.int64).T
    _, first = np.unique((x << 32) + y, return_index=True)
    return np.asarray(points[np.sort(first)], dtype=np.float32)


def _deviation(drawn: Floats, poses: Floats) -> float:
    """Return the largest displacement of points at RANGE between two sets of poses, metres."""
    change = se2.between(drawn, poses)
    return float(np.max(np.hypot(change[:, 0], change[:, 1]) + RANGE * np.abs(change[:, 2]), initial=0.0))


def _style() -> rr.Points3D:
    return rr.Points3D.from_fields(colors=colours.BACKDROP, radii=_POINT_SIZE)
