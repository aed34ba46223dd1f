"""A scan as if all its beams had been measured at its stamp."""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.messages import Scan

from .odometry import OdometryHistory
from .segments import Floats

KNOTS = 8  # poses along the sweep between which the motion is taken as constant; a revolution of a slow lidar is 0.1 s


def deskew(scan: Scan, odometry: OdometryHistory, mount: se2.Pose) -> tuple[Floats, Floats]:
    """Ranges and bearings (n,), seen from where the lidar was at the scan's stamp; the motion is the odometry's.

    Bearings stay in the order of the beams and are unwrapped, so a full turn may cover a little more or less than that.
    """
    duration = float(scan.time_offsets[-1]) if len(scan.time_offsets) else 0.0
    if duration <= 0.0 or not len(odometry):
        return scan.ranges, scan.angles
    offsets = np.linspace(0.0, duration, KNOTS)
    bases = odometry.at_each(scan.stamp + offsets)
    lidars = se2.between(se2.compose(bases[0], mount), se2.compose(bases, mount))
    heading = np.interp(scan.time_offsets, offsets, np.unwrap(lidars[:, 2]))
    x = np.interp(scan.time_offsets, offsets, lidars[:, 0]) + scan.ranges * np.cos(scan.angles + heading)
    y = np.interp(scan.time_offsets, offsets, lidars[:, 1]) + scan.ranges * np.sin(scan.angles + heading)
    bearing = np.arctan2(y, x)
    turned = scan.angles + heading
    bearing = turned + se2.wrap(np.where(np.isnan(bearing), 0.0, bearing - turned))
    return np.hypot(x, y), bearing
