"""Scans as the settings of their lidars say: mount, clock, range bias and limits of the range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.messages import Message, Scan, on_clock_of_first

from ..config import Config


def as_used(message: Message, config: Config) -> Message:
    """Return a message as it was used with the settings; only scans are changed.

    A scan states the mount of its lidar, unless the settings state none, has a stamp on the first lidar's clock, and
    ranges without their bias; ranges outside the limits of the settings and of the scan are no-returns.
    """
    scan = on_clock_of_first(message, config.second_lidar_delay)
    if not isinstance(scan, Scan):
        return scan
    lidar = config.of_lidar(scan.lidar)
    usable = (scan.ranges >= max(lidar.range_min, scan.range_min)) & (
        scan.ranges <= min(lidar.range_max, scan.range_max)
    )  # False for NaN
    ranges = np.where(usable, scan.ranges - lidar.range_bias, np.nan)
    return replace(scan, ranges=ranges, mount=scan.mount if lidar.mount is None else np.array(lidar.mount))
