"""Correct the beams of a scan for the robot's motion during the sweep.

The motion is that of odometry, smoothed because its stamps are not exact, and without its systematic errors. Its
random error is added to the covariances of the features (see `motion_uncertainty`).
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable
from drivers.messages import Scan
from features.normal_limits import NORMAL_LIMIT

from ..bounds import MAX_MOUNT, MAX_TURN
from ..config import LidarConfig
from ..errors import MapError
from ..geometry.pose_arrays import between_each, compose_each, unwrapped
from ..geometry.segments import Floats
from ..odometry.error_model import OdometryModel
from ..odometry.history import MIN_SPEED, OdometryHistory, wheel_travel
from ..odometry.measurement_clock import USUAL_PERIOD
from ..odometry.smoothing import is_within_jitter, smoothed_poses
from .sweep_motion import SweepMotion, beams_from_middle, breakpoints_of, travelled_at

# Seconds between the poses along the sweep between which the motion is interpolated: shorter than the interval of
# odometry readings. Origin: measured at 2 revolutions per second, relative NEES 2.32 with 70 ms, 0.76 with 13 ms.
KNOT_INTERVAL = 0.0125
# Metres of wheel travel over a sweep below which the robot counts as standing, whatever the jitter of the readings is:
# 0.2 mm at either wheel looks like a milliradian of turning, would bend the scan, and the first keyframe, which defines
# the map, is nearly always taken standing. Origin: measured; the data are not recorded.
MIN_SWEEP_TRAVEL = 2e-3
# Origin: definition.
PARABOLA_PARAMETERS = 3


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
    x, y, heading = scan.mount.tolist()
    if not (max(abs(x), abs(y)) <= MAX_MOUNT and abs(heading) <= MAX_TURN):  # also NaN
        place = f"x {x:g} m, y {y:g} m, heading {heading:g} radians"
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
    at = np.array([mount])
    lidars = between_each(at, compose_each(moves, at))
    lidars[:, 2] = unwrapped(lidars[:, 2].copy())
    # copied, as arrays that are read-only or reversed would be compiled for separately
    ranges, angles, beam_times = (np.array(each, order="C") for each in (ranges, scan.angles, scan.time_offsets))
    ranges, bearings, of_beams = beams_from_middle(ranges, angles, beam_times, offsets, lidars, moves)
    readings, _ = odometry.readings_between(scan.stamp - USUAL_PERIOD, scan.stamp + duration)
    breakpoints = breakpoints_of(readings, scan.stamp, scan.stamp + duration)
    travelled = travelled_at(poses, offsets, breakpoints - scan.stamp)
    motion = SweepMotion(
        beam_times - 0.5 * duration, of_beams, speed_error, breakpoints - middle, np.diff(travelled), fitted
    )
    return DeskewedScan(middle, se2.compose(reference, error), ranges, bearings, motion)


def _is_standing(odometry: OdometryHistory, begin: float, duration: float, motion: se2.Pose) -> bool:
    """Return True if the smoothed `motion` during a sweep can be jitter; `begin` and `duration` are in seconds."""
    travel = float(wheel_travel(motion))
    if travel < MIN_SWEEP_TRAVEL or travel > MIN_SPEED * duration:
        return travel < MIN_SWEEP_TRAVEL
    return is_within_jitter(odometry, begin, begin + duration, travel)


@compiled
def _fitted_middle(times, poses):  # type: ignore[no-untyped-def]
    """Return (3,) the value at time 0 of the parabolas fitted to poses (n, 3) at `times` (n,), symmetric about it."""
    count = len(times)
    mean, product, squares, fourths = np.zeros(3), np.zeros(3), 0.0, 0.0
    for k in range(count):
        square = times[k] ** 2
        squares, fourths = squares + square, fourths + square * square
        for axis in range(3):
            mean[axis] += poses[k, axis] / count
            product[axis] += square * poses[k, axis]
    if count <= PARABOLA_PARAMETERS:
        return mean
    curvature = (product - squares * mean) / (fourths - squares * squares / count)
    return mean - squares / count * curvature
