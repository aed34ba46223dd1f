"""Place the scans of a recording on a finished trajectory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Message, Odometry, Scan

from ...config import Config, LidarConfig
from ...geometry.segments import Floats
from ...odometry.history import OdometryHistory
from ..scan_settings import as_used
from ..tum import STAMP_TOLERANCE, Trajectory


@immutable
class PlacedScan:
    """Scan in the map.

    stamp   seconds
    origin  (2,) position of the lidar, metres
    points  (n, 2) end points of the beams without no-returns, metres
    """

    stamp: float
    origin: Floats
    points: Floats


def place_scans(
    messages: Iterable[Message], trajectory: Trajectory, config: Config | None = None
) -> Iterator[PlacedScan]:
    """Yield the scans among `messages` within the time of `trajectory`, de-skewed along it, in the map.

    With `config`, the settings of the lidars are applied, as during SLAM; without it, this was done (`open_recording`).
    """
    from ...preprocessing.deskew import deskew, lidar_mount, sweep_middle  # only here: most exports place no scans

    path = OdometryHistory()  # the final trajectory takes the place of odometry
    for stamp, pose in zip(trajectory.stamps.tolist(), trajectory.poses, strict=True):
        path.add(Odometry(stamp, pose))
    first, last = trajectory.stamps[[0, -1]] + np.array([-STAMP_TOLERANCE, STAMP_TOLERANCE])
    for message in messages:
        scan = message if config is None else as_used(message, config)
        if not isinstance(scan, Scan) or not first <= sweep_middle(scan) <= last:
            continue
        mount = lidar_mount(scan, LidarConfig())
        sweep = deskew(scan, path, mount)
        usable = np.isfinite(sweep.ranges)
        ranges, bearings = sweep.ranges[usable], sweep.bearings[usable]
        pose = se2.compose(path.at(sweep.stamp), mount)
        points = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        yield PlacedScan(sweep.stamp, pose[:2], se2.transform(pose, points))
