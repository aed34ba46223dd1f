"""Correct the beams of a scan for the robot's motion during the sweep.

The motion is that of odometry, smoothed because its stamps are not exact, and without its systematic errors. Its
random error is added to the covariances of the features (see `motion_uncertainty`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Scan
from features.normal_limits import NORMAL_LIMIT

from ..bounds import MAX_MOUNT
from ..config import LidarConfig
from ..errors import MapError
from ..geometry.pose_arrays import between_each, compose_each, unwrapped
from ..geometry.segments import Floats
from ..odometry.error_model import OdometryModel
from ..odometry.history import MIN_SPEED, OdometryHistory, wheel_travel
from ..odometry.measurement_clock import USUAL_PERIOD
from ..odometry.smoothing import is_within_jitter, smoothed_poses

# Seconds between the poses along the sweep between which the motion is interpolated: shorter than the interval of
# odometry readings. Origin: measured at 2 revolutions per second, relative NEES 2.32 with 70 ms, 0.76 with 13 ms.
KNOT_INTERVAL = 0.0125
# Metres of wheel travel over a sweep below which the robot counts as standing, whatever the jitter of the readings is:
# 0.2 mm at either wheel looks like a milliradian of turning, would bend the scan, and the first keyframe, which defines
# the map, is nearly always taken standing. Origin: measured; the data are not recorded.
MIN_SWEEP_TRAVEL = 2e-3
# Origin: definition.
PARABOLA_PARAMETERS = 3


@dataclass(frozen=True, eq=False)
class SweepMotion:
    """Motion of odometry during a sweep, relative to the pose in its middle.

    times        (n,) seconds from the middle to each beam
    poses        (n, 3) [x, y, heading] of the base at each beam
    speed_error  standard deviation of the relative error of the speed, see `smoothed_poses`
    breakpoints  (m + 1,) seconds from the middle to the readings between which odometry's error changes evenly
    steps        (m,) metres of wheel travel between these
    fitted       seconds from the middle to either end of the interval that the reference is fitted to
    offset       metres of wheel travel between the middle and the stamp that the scan was moved to
    """

    times: Floats
    poses: Floats
    speed_error: float
    breakpoints: Floats
    steps: Floats
    fitted: float
    offset: float = 0.0

    @staticmethod
    @lru_cache(maxsize=2)  # all scans of a lidar have as many beams; there may be two lidars
    def standing(beams: int) -> SweepMotion:
        """Return that of a robot that stands."""
        return SweepMotion(np.zeros(beams), np.zeros((beams, 3)), 0.0, np.array([0.0, 1.0]), np.zeros(1), 0.0)

    @cached_property
    def travel(self) -> Floats:
        """(n,) metres of wheel travel between the middle and each beam."""
        return wheel_travel(self.poses)

    @cached_property
    def reach(self) -> float:
        """Metres of wheel travel between the stamp and the beam that is farthest from it."""
        return float(self.travel.max(initial=0.0)) + self.offset


@immutable
class DeskewedScan:
    """A scan as seen from the lidar's pose at `stamp`, when odometry was at `odometry`.

    ranges, bearings  (n,) metres and radians in the lidar's frame; bearings in the order of the beams, unwrapped: a
                      full turn may cover a little more or less than 2 pi
    motion            during the sweep
    """

    stamp: float
    odometry: se2.Pose
    ranges: Floats
    bearings: Floats
    motion: SweepMotion


def sweep_middle(scan: Scan) -> float:
    """Return the stamp in the middle of a scan's sweep, seconds."""
    return scan.stamp + 0.5 * scan.duration


def lidar_mount(scan: Scan, lidar: LidarConfig) -> se2.Pose:
    """Return the lidar's pose on the base [x, y, heading]: as configured, else as recorded, else zero.

    Raises MapError if the scan states a place where no lidar is: in another unit, or relative to another frame.
    """
    if lidar.mount is not None:
        return np.array(lidar.mount)
    if scan.mount is None:
        return np.zeros(3)
    if not (np.isfinite(scan.mount).all() and np.abs(scan.mount[:2]).max() <= MAX_MOUNT):
        place = f"x {scan.mount[0]:g} m, y {scan.mount[1]:g} m"
        raise MapError(f"no lidar is mounted at {place}, as these scans state; lidar.mount=[x,y,heading] corrects it")
    return scan.mount


def deskew(
    scan: Scan,
    odometry: OdometryHistory,
    mount: se2.Pose,
    range_bias: float = 0.0,
    model: OdometryModel | None = None,
) -> DeskewedScan:
    """Transform every beam of a scan to the lidar's pose in the middle of its sweep, with odometry's motion.

    The motion is smoothed (see `smoothed_poses`). The reference is the middle of a motion at constant acceleration that
    is fitted to it within USUAL_PERIOD, as the random error of odometry in the middle would turn the whole scan.
    The two differ by what the `model` states; a larger difference is a sudden change of speed, and is limited.
    `range_bias` (metres) is subtracted from all ranges, and the systematic errors of odometry are corrected by the
    `model`. Without a model, the reference is odometry in the middle.
    """
    duration = scan.duration
    ranges = scan.ranges - range_bias if range_bias else scan.ranges
    if duration <= 0.0 or not len(odometry):
        at = odometry.at(scan.stamp) if len(odometry) else np.zeros(3)
        return DeskewedScan(scan.stamp, at, ranges, scan.angles, SweepMotion.standing(len(ranges)))
    middle = sweep_middle(scan)
    half = math.ceil(0.5 * duration / KNOT_INTERVAL)
    offsets = np.linspace(0.0, duration, 2 * half + 1)
    poses, speed_error = smoothed_poses(odometry, scan.stamp + offsets)
    reference = poses[half]
    moves = between_each(reference[None], poses)
    travels = wheel_travel(moves)
    if _is_standing(odometry, scan.stamp, duration, se2.between(poses[0], poses[-1])):
        return DeskewedScan(middle, reference, ranges, scan.angles, SweepMotion.standing(len(ranges)))
    times = offsets - 0.5 * duration
    central = np.abs(times) <= 0.5 * USUAL_PERIOD
    error, fitted = np.zeros(3), 0.0
    if model is not None:
        fitted = float(times[central][-1])
        limit = NORMAL_LIMIT * model.deviations_of_fit(float(travels[central].max()))
        error = np.clip(_fitted_middle(times[central], moves[central]), -limit, limit)
        moves = model.correct(between_each(error[None], moves))
    ranges, bearings = _seen_from_middle(scan, ranges, offsets, moves, mount)
    breakpoints = _breakpoints(odometry, scan.stamp, scan.stamp + duration)
    travelled = _travelled(poses, offsets, breakpoints - scan.stamp)
    motion = SweepMotion(
        scan.time_offsets - 0.5 * duration,
        np.column_stack([np.interp(scan.time_offsets, offsets, moves[:, k]) for k in range(3)]),
        speed_error,
        breakpoints - middle,
        np.diff(travelled),
        fitted,
    )
    return DeskewedScan(middle, se2.compose(reference, error), ranges, bearings, motion)


def _is_standing(odometry: OdometryHistory, begin: float, duration: float, motion: se2.Pose) -> bool:
    """Return True if the smoothed `motion` during a sweep can be jitter; `begin` and `duration` are in seconds."""
    travel = float(wheel_travel(motion))
    if travel < MIN_SWEEP_TRAVEL or travel > MIN_SPEED * duration:
        return travel < MIN_SWEEP_TRAVEL
    return is_within_jitter(odometry, begin, begin + duration, travel)


def _seen_from_middle(
    scan: Scan, ranges: Floats, offsets: Floats, moves: Floats, mount: se2.Pose
) -> tuple[Floats, Floats]:
    """Return ranges and bearings (n,) of a scan as seen from the lidar in the middle of the sweep.

    offsets  (k,) seconds from the start of the sweep
    moves    (k, 3) [x, y, heading] of the base relative to the middle, at these
    """
    at = np.array([mount])
    lidars = between_each(at, compose_each(moves, at))
    turned = scan.angles + np.interp(scan.time_offsets, offsets, unwrapped(lidars[:, 2].copy()))
    x = np.interp(scan.time_offsets, offsets, lidars[:, 0]) + ranges * np.cos(turned)
    y = np.interp(scan.time_offsets, offsets, lidars[:, 1]) + ranges * np.sin(turned)
    shift = se2.wrap(np.arctan2(y, x) - turned)
    return np.hypot(x, y), turned + np.where(np.isfinite(shift), shift, 0.0)


def _travelled(poses: Floats, offsets: Floats, wanted: Floats) -> Floats:
    """Return metres of wheel travel from the start of a sweep to the `wanted` times (m,), seconds from there.

    poses, offsets  (k, 3) smoothed poses and (k,) their times: between readings, noise would count as travel

    Before and after the sweep, the speed is that at its ends.
    """
    travelled = np.concatenate([[0.0], np.cumsum(wheel_travel(between_each(poses[:-1], poses[1:])))])
    slopes = np.diff(travelled) / np.diff(offsets)
    outside = slopes[0] * np.minimum(wanted, 0.0) + slopes[-1] * np.maximum(wanted - offsets[-1], 0.0)
    return np.asarray(np.interp(wanted, offsets, travelled) + outside)


def _breakpoints(odometry: OdometryHistory, begin: float, end: float) -> Floats:
    """Return (m + 1,) stamps between which odometry's error changes evenly, from before a sweep until after it.

    These are the stamps of the readings. Where readings are farther apart than USUAL_PERIOD, during which robots
    move smoothly, stamps between them are added.
    """
    stamps, _ = odometry.readings_between(begin - USUAL_PERIOD, end)
    inside = stamps[(stamps > begin) & (stamps < end)]
    first = max(stamps[stamps <= begin], default=begin - USUAL_PERIOD)
    last = min(min(stamps[stamps >= end], default=np.inf), end + USUAL_PERIOD)
    stamps = np.concatenate([[first], inside, [last]])
    parts = np.ceil(np.diff(stamps) / USUAL_PERIOD).astype(int)
    return np.asarray(np.interp(np.arange(parts.sum() + 1), np.concatenate([[0], np.cumsum(parts)]), stamps))


def _fitted_middle(times: Floats, poses: Floats) -> Floats:
    """Return (3,) the value at time 0 of the parabolas fitted to poses (n, 3) at `times` (n,), symmetric about it."""
    if len(times) <= PARABOLA_PARAMETERS:
        return np.asarray(poses.mean(axis=0))
    squares = times**2
    centred = squares - squares.mean()
    curvature = centred @ poses / (centred @ centred)
    return np.asarray(poses.mean(axis=0) - squares.mean() * curvature)
