"""A scan as if all its beams had been measured at once, in the middle of its sweep.

The motion during the sweep is the odometry's. Its error is common to all beams of about the same time, so it would not
average out over a wall's rays: it goes into the covariance of what is made of the scan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.messages import Scan

from ..config import LidarConfig
from ..geometry.segments import CornerPoints, Floats, Segments
from ..odometry.error_model import OdometryModel
from ..odometry.history import OdometryHistory, wheel_travel

if TYPE_CHECKING:
    from features.types import Lines

KNOTS = 8  # poses along the sweep between which the motion is taken as constant; a revolution of a slow lidar is 0.1 s
# Metres of way that odometry must claim over a sweep to be believed. Less is the jitter of its readings while the robot
# stands: a fifth of a millimetre at either wheel looks like a milliradian of turning, which would bend the scan, and
# the first keyframe, which the whole map hangs on, is nearly always taken standing.
LEAST_WAY = 2e-3
JITTER = np.array([2e-4, 2e-4, 8e-4])  # metres, metres, radians, of one reading, likewise
ON_LINE = 0.05  # metres from a line's continuation within which a point may be one of the same wall


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A scan seen from where the lidar was at `stamp`, when odometry was at `odometry`.

    ranges, bearings  (n,); bearings in the order of the beams, unwrapped: a full turn may cover a little more or less
    way               (n,) metres the wheels rolled between each beam and the stamp
    """

    stamp: float
    odometry: se2.Pose
    ranges: Floats
    bearings: Floats
    travel: Floats

    def points(self, lines: Lines) -> tuple[Floats, Floats]:
        """The valid returns as points (p, 2) in the lidar's frame, and those (q, 2) that lie on none of `lines`, nor go
        on where one ends: the last returns from a corridor's wall move along with the robot, and hold nothing."""
        points = np.column_stack([self.ranges * np.cos(self.bearings), self.ranges * np.sin(self.bearings)])
        valid = np.asarray(np.isfinite(points).all(axis=1))
        loose = valid.copy()
        for first, last in zip(lines.first, lines.last, strict=True):
            if first <= last:
                loose[first : last + 1] = False
            else:  # over the end of a full revolution
                loose[first:] = False
                loose[: last + 1] = False
        loose[loose] = ~_continues(points[loose], lines)
        return points[valid], points[loose]


def _continues(points: Floats, lines: Lines) -> NDArray[np.bool_]:
    """Which points (q, 2) lie on the continuation of one of the lines, by as much again as was seen of it."""
    half = 0.5 * (lines.end - lines.start)
    from_middle = points[:, None] - 0.5 * (lines.start + lines.end)
    length = np.hypot(half[:, 0], half[:, 1])
    along = (from_middle * half).sum(axis=-1) / length
    across = (half[:, 0] * from_middle[..., 1] - half[:, 1] * from_middle[..., 0]) / length
    return np.asarray(((np.abs(across) < ON_LINE) & (np.abs(along) < 3.0 * length)).any(axis=1))


def middle_of(scan: Scan) -> float:
    """The stamp in the middle of a scan's sweep, seconds."""
    return scan.stamp + 0.5 * scan.duration


def mount_of(scan: Scan, lidar: LidarConfig) -> se2.Pose:
    """Where the lidar stands on the base [x, y, heading]: as configured, else as the recording states, else zero."""
    if lidar.mount is not None:
        return np.array(lidar.mount)
    return np.zeros(3) if scan.mount is None else scan.mount


def deskew(scan: Scan, odometry: OdometryHistory, mount: se2.Pose, range_bias: float = 0.0) -> Sweep:
    """Move every beam of a scan to the middle of its sweep, with the motion that odometry saw.

    Where odometry was then is the mean over the sweep, as far as that differs from the reading in the middle by no more
    than its jitter: by a step of an encoder the whole scan would be turned. What differs more is a change of speed.
    `range_bias` in metres is what all ranges are known to be too long by.
    """
    duration = scan.duration
    ranges = scan.ranges - range_bias if range_bias else scan.ranges
    if duration <= 0.0 or not len(odometry):
        at = odometry.at(scan.stamp) if len(odometry) else np.zeros(3)
        return Sweep(scan.stamp, at, ranges, scan.angles, np.zeros(len(ranges)))
    middle = middle_of(scan)
    offsets = np.linspace(0.0, duration, KNOTS)
    reference = odometry.at(middle)
    moves = se2.between(reference, odometry.at_each(scan.stamp + offsets))
    travelled = wheel_travel(moves)
    if travelled[0] + travelled[-1] < LEAST_WAY:
        return Sweep(middle, reference, ranges, scan.angles, np.zeros(len(ranges)))
    mean = np.clip(moves.mean(axis=0), -JITTER, JITTER)
    moves = se2.between(mean, moves)
    lidars = se2.between(mount, se2.compose(moves, mount))
    turned = scan.angles + np.interp(scan.time_offsets, offsets, np.unwrap(lidars[:, 2]))
    x = np.interp(scan.time_offsets, offsets, lidars[:, 0]) + ranges * np.cos(turned)
    y = np.interp(scan.time_offsets, offsets, lidars[:, 1]) + ranges * np.sin(turned)
    shift = se2.wrap(np.arctan2(y, x) - turned)
    travel = np.interp(scan.time_offsets, offsets, travelled)
    bearings = turned + np.where(np.isfinite(shift), shift, 0.0)
    return Sweep(middle, se2.compose(reference, mean), np.hypot(x, y), bearings, travel)


def loosen(
    segments: Segments, corners: CornerPoints, lines: Lines, sweep: Sweep, model: OdometryModel
) -> tuple[Segments, CornerPoints]:
    """Add to the covariances what the odometry's `model` leaves uncertain of the motion during the sweep."""
    if not len(segments) or not sweep.travel.any():
        return segments, corners
    middle = np.where(lines.last >= lines.first, (lines.first + lines.last) // 2, 0)
    translation, rotation = model.variances(sweep.travel[middle])
    across = np.column_stack([-np.sin(segments.frame[:, 2]), np.cos(segments.frame[:, 2])])
    lever = across[:, 1] * segments.frame[:, 0] - across[:, 0] * segments.frame[:, 1]
    covariance = segments.covariance.copy()
    covariance[:, 0, 0] += translation + rotation * lever**2
    covariance[:, 0, 1] += rotation * lever
    covariance[:, 1, 0] += rotation * lever
    covariance[:, 1, 1] += rotation
    shift, turn = (v[corners.segments].mean(axis=1)[:, None, None] for v in (translation, rotation))
    levers = np.column_stack([-corners.position[:, 1], corners.position[:, 0]])
    turning = turn * levers[:, :, None] * levers[:, None, :]
    return replace(segments, covariance=covariance), replace(
        corners, covariance=corners.covariance + shift * np.eye(2) + turning
    )
