"""Correct the beams of a scan for the robot's motion during the sweep.

The motion is that of odometry without its systematic errors. Its random error is common to neighbouring beams and does
not average out over a wall, so it is added to the covariances of the features. It does not average out over a scan
either: the heading is a random walk from the middle of the sweep to both of its ends. With the variance q per metre and
the travel S from the middle to an end, the mean over all beams has the variance q S / 6, a third of the mean variance
q S / 2 of a beam. So a scan has no more than three independent errors, however many segments it has.
"""

from __future__ import annotations

import math
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

# Seconds between the poses along the sweep between which the motion is interpolated: shorter than the interval of
# odometry readings. Origin: measured at 2 revolutions per second, relative NEES 2.32 with 70 ms, 0.76 with 13 ms.
KNOT_INTERVAL = 0.0125
# Seconds in the middle of the sweep over which the reference is averaged: robots hardly change their speed meanwhile.
# Origin: chosen, a revolution of common lidars; not measured.
REFERENCE_INTERVAL = 0.1
# Metres of wheel travel over a sweep below which the robot counts as standing: 0.2 mm of jitter at either wheel looks
# like a milliradian of turning, would bend the scan, and the first keyframe, which defines the map, is nearly always
# taken standing. Origin: measured; the data are not recorded.
MIN_SWEEP_TRAVEL = 2e-3
# Metres, metres, radians: jitter of one odometry reading. Origin: measured, as MIN_SWEEP_TRAVEL.
JITTER = np.array([2e-4, 2e-4, 8e-4])
# Independent errors of the motion in one scan. Origin: geometry, see above.
INDEPENDENT_ERRORS = 3
# Metres from the continuation of a line within which a point may belong to the same wall. Origin: chosen; not measured.
LINE_DISTANCE = 0.05
# Half lengths of a line, from its middle, up to which its continuation reaches: as much again on either side.
# Origin: chosen; not measured.
CONTINUATION = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class DeskewedScan:
    """A scan as seen from the lidar's pose at `stamp`, when odometry was at `odometry`.

    ranges, bearings  (n,) metres and radians in the lidar's frame; bearings in the order of the beams, unwrapped: a
                      full turn may cover a little more or less than 2 pi
    travel            (n,) metres of wheel travel between each beam and the stamp
    """

    stamp: float
    odometry: se2.Pose
    ranges: Floats
    bearings: Floats
    travel: Floats

    def points(self, lines: Lines) -> tuple[Floats, Floats]:
        """Return the valid returns (p, 2) in the lidar's frame, and those (q, 2) on no line or continuation of one.

        The last returns from a corridor's walls move with the robot, so they must not count as loose points.
        """
        points = np.column_stack([self.ranges * np.cos(self.bearings), self.ranges * np.sin(self.bearings)])
        valid = np.asarray(np.isfinite(points).all(axis=1))
        loose = valid.copy()
        for first, last in zip(lines.first, lines.last, strict=True):
            if first <= last:
                loose[first : last + 1] = False
            else:  # over the end of a full revolution
                loose[first:] = False
                loose[: last + 1] = False
        loose[loose] = ~_on_continuation(points[loose], lines)
        return points[valid], points[loose]


def _on_continuation(points: Floats, lines: Lines) -> NDArray[np.bool_]:
    """Return which points (q, 2) lie on the continuation of a line, which is as long again on either side."""
    half = 0.5 * (lines.end - lines.start)
    from_middle = points[:, None] - 0.5 * (lines.start + lines.end)
    length = np.hypot(half[:, 0], half[:, 1])
    along = (from_middle * half).sum(axis=-1) / length
    across = (half[:, 0] * from_middle[..., 1] - half[:, 1] * from_middle[..., 0]) / length
    return np.asarray(((np.abs(across) < LINE_DISTANCE) & (np.abs(along) < CONTINUATION * length)).any(axis=1))


def sweep_middle(scan: Scan) -> float:
    """Return the stamp in the middle of a scan's sweep, seconds."""
    return scan.stamp + 0.5 * scan.duration


def lidar_mount(scan: Scan, lidar: LidarConfig) -> se2.Pose:
    """Return the lidar's pose on the base [x, y, heading]: as configured, else as recorded, else zero."""
    if lidar.mount is not None:
        return np.array(lidar.mount)
    return np.zeros(3) if scan.mount is None else scan.mount


def deskew(
    scan: Scan,
    odometry: OdometryHistory,
    mount: se2.Pose,
    range_bias: float = 0.0,
    model: OdometryModel | None = None,
) -> DeskewedScan:
    """Transform every beam of a scan to the lidar's pose in the middle of its sweep, with odometry's motion.

    The reference is odometry's mean over REFERENCE_INTERVAL, if that differs from the reading in the middle by no more
    than its jitter: a single encoder step would turn the whole scan. A larger difference is a change of speed, and is
    limited to the jitter. `range_bias` (metres) is subtracted from all ranges, and the systematic errors of odometry
    are corrected by the `model`, if there is one.
    """
    duration = scan.duration
    ranges = scan.ranges - range_bias if range_bias else scan.ranges
    if duration <= 0.0 or not len(odometry):
        at = odometry.at(scan.stamp) if len(odometry) else np.zeros(3)
        return DeskewedScan(scan.stamp, at, ranges, scan.angles, np.zeros(len(ranges)))
    middle = sweep_middle(scan)
    offsets = np.linspace(0.0, duration, 2 + math.ceil(duration / KNOT_INTERVAL))
    reference = odometry.at(middle)
    moves = se2.between(reference, odometry.at_each(scan.stamp + offsets))
    travels = wheel_travel(moves)
    if travels[0] + travels[-1] < MIN_SWEEP_TRAVEL:
        return DeskewedScan(middle, reference, ranges, scan.angles, np.zeros(len(ranges)))
    central = np.abs(offsets - 0.5 * duration) <= 0.5 * REFERENCE_INTERVAL
    mean = np.clip(moves[central].mean(axis=0), -JITTER, JITTER)
    moves = se2.between(mean, moves)
    if model is not None:
        moves = model.correct(moves)
    lidars = se2.between(mount, se2.compose(moves, mount))
    turned = scan.angles + np.interp(scan.time_offsets, offsets, np.unwrap(lidars[:, 2]))
    x = np.interp(scan.time_offsets, offsets, lidars[:, 0]) + ranges * np.cos(turned)
    y = np.interp(scan.time_offsets, offsets, lidars[:, 1]) + ranges * np.sin(turned)
    shift = se2.wrap(np.arctan2(y, x) - turned)
    travel = np.interp(scan.time_offsets, offsets, travels)
    bearings = turned + np.where(np.isfinite(shift), shift, 0.0)
    return DeskewedScan(middle, se2.compose(reference, mean), np.hypot(x, y), bearings, travel)


def add_motion_uncertainty(
    segments: Segments, corners: CornerPoints, lines: Lines, scan: DeskewedScan, model: OdometryModel
) -> tuple[Segments, CornerPoints]:
    """Add odometry's uncertainty during the sweep to the covariances of segments and corners.

    The segments enter the estimate as independent, so their variances are larger if they are more than the independent
    errors in the scan.
    """
    if not len(segments) or not scan.travel.any():
        return segments, corners
    middle = np.where(lines.last >= lines.first, (lines.first + lines.last) // 2, 0)
    sharing = max(1.0, len(segments) / INDEPENDENT_ERRORS)
    translation, rotation = (sharing * variance for variance in model.variances(scan.travel[middle]))
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
