"""The scans of a recording where the finished path says they were taken."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.messages import Message, Odometry, Scan

from ...config import LidarConfig
from ...odometry.history import OdometryHistory
from ...preprocessing.deskew import deskew, middle_of, mount_of
from ..tum import SAME_STAMP, Floats, Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class PlacedScan:
    """A scan in the map: taken at `stamp` from `origin` (2,), its returns at `points` (n, 2), metres."""

    stamp: float
    origin: Floats
    points: Floats


def placed_scans(messages: Iterable[Message], trajectory: Trajectory, lidar: LidarConfig) -> Iterator[PlacedScan]:
    """The scans among `messages` that were taken within the time of `trajectory`, each straightened along it.

    Ranges outside the limits of `lidar` and of the scan are left out, as they were when the path was estimated.
    """
    path = OdometryHistory()  # the finished path is to be followed as odometry is while SLAM runs
    for stamp, pose in zip(trajectory.stamps.tolist(), trajectory.poses, strict=True):
        path.add(Odometry(stamp, pose))
    first, last = trajectory.stamps[[0, -1]] + np.array([-SAME_STAMP, SAME_STAMP])
    for scan in messages:
        if not isinstance(scan, Scan) or not first <= middle_of(scan) <= last:
            continue
        mount = mount_of(scan, lidar)
        sweep = deskew(scan, path, mount, lidar.range_bias)
        usable = (scan.ranges >= max(lidar.range_min, scan.range_min)) & (
            scan.ranges <= min(lidar.range_max, scan.range_max)
        )  # NaN is not
        reach, bearing = sweep.ranges[usable], sweep.bearings[usable]
        pose = se2.compose(path.at(sweep.stamp), mount)
        points = np.column_stack([reach * np.cos(bearing), reach * np.sin(bearing)])
        yield PlacedScan(sweep.stamp, pose[:2], se2.transform(pose, points))
