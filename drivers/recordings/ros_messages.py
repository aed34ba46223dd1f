"""Conversion of ROS messages to this project's messages, from ROS 1 bags, ROS 2 bags, MCAP files and ROS 2 itself."""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..immutable import immutable
from ..messages import MAX_SPAN, Floats, Odometry, Scan, YawRate
from ..se2 import Pose, wrap
from ..timestamps import NANOSECONDS, to_seconds
from .range_units import FAR

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TRANSFORMS_ROS1 = "tf/msg/tfMessage"
IMU = "sensor_msgs/msg/Imu"
POSE = "geometry_msgs/msg/PoseStamped"
BEAMS = "std_msgs/msg/Float64MultiArray"
"""Exact beams: range_min, range_max, then all angles, all ranges, all time offsets (seconds), as float64."""

MIN_ANGLE_STEP = 1e-6
"""Radians between beams; smaller steps are invalid."""
MAX_RATE = 6000.0
"""Rates above are invalid. No gyroscope measures as many degrees per second, which some drivers publish instead of
radians."""
MAX_COORDINATE = 1e9
"""Metres; poses that are farther away are invalid."""

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@cache
def type_store(encoding: str) -> Typestore:
    """Return the standard message definitions for an encoding, `cdr` (ROS 2) or `ros1`.

    They are the same in all distributions, so a bag's own definitions are not needed.
    """
    if encoding == "cdr":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in (TRANSFORMS, TRANSFORMS_ROS1):
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def decode(data: bytes, msgtype: str, encoding: str) -> Any:
    """Deserialise a ROS message of a type; raises ValueError if the bytes are invalid."""
    store = type_store(encoding)
    try:
        return store.deserialize_cdr(data, msgtype) if encoding == "cdr" else store.deserialize_ros1(data, msgtype)
    except (SerdeError, ValueError, IndexError, MemoryError, OverflowError) as error:
        raise ValueError(f"{msgtype} cannot be decoded") from error


def stamp_of(header: Any, received: int) -> float:
    """Return the header's stamp in seconds; if it is zero, the time of reception (given in nanoseconds)."""
    nanoseconds = header.stamp.sec * NANOSECONDS + header.stamp.nanosec
    return to_seconds(nanoseconds or received)


def heading_of(quaternion: Any) -> float:
    """Return the heading in [-pi, pi) of a quaternion with members x y z w; raises ValueError if its norm is not 1."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if math.isnan(norm):
        raise ValueError("orientation is not a number")
    if not 0.9 < norm < 1.1:
        raise ValueError("orientation is not a unit quaternion")
    if x == 0.0 and y == 0.0:
        heading = 2.0 * math.atan2(z, w)
    else:
        heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return heading if -math.pi <= heading < math.pi else float(wrap(heading))


def planar_pose(pose: Any) -> Pose:
    """Return [x, y, heading] of a geometry_msgs/Pose; raises ValueError if it is invalid."""
    planar = np.array([pose.position.x, pose.position.y, heading_of(pose.orientation)])
    if not np.all(np.abs(planar) < MAX_COORDINATE):
        raise ValueError("pose is not finite")
    return planar


def planar_transform(transform: Any) -> Pose:
    """Return [x, y, heading] of a geometry_msgs/Transform; raises ValueError if it is invalid."""
    planar = np.array([transform.translation.x, transform.translation.y, heading_of(transform.rotation)])
    if not np.all(np.abs(planar) < MAX_COORDINATE):
        raise ValueError("transform is not finite")
    return planar


@lru_cache(maxsize=256)
def _steps(start: float, step: float, count: int) -> Floats:
    values = start + step * np.arange(count, dtype=np.float64)
    values.flags.writeable = False
    return values


@immutable
class LidarMount:
    """Mount of a lidar on the robot.

    pose         [x, y, heading] in the base's frame; None if unknown
    upside_down  true if the lidar's z axis points down
    tilt         angle between the lidar's plane and a horizontal one, radians; zero if it is negligible
    projection   (2, 2) of a tilted lidar, from directions in its plane to their horizontal parts in the frame of
                 `pose`; None if the lidar is level, or tilted too much for scans along the floor
    """

    pose: Pose | None = None
    upside_down: bool = False
    tilt: float = 0.0
    projection: Floats | None = None

    def describe(self) -> list[str]:
        """Return how scans are read of a lidar that is upside down or tilted, as lines of text."""
        lines = ["upside down by its transform: scans are mirrored"] if self.upside_down else []
        if self.projection is not None:
            tilt = f"tilted by {math.degrees(self.tilt):.1f} degrees by its transform"
            lines.append(f"{tilt}: scans are projected onto a horizontal plane")
        return lines

    def seen_from_above(self, angles: Floats, ranges: Floats) -> tuple[Floats, Floats]:
        """Return the directions (n,) and horizontal distances (n,) of returns, in the frame of `pose`.

        A vertical wall is then where it is: a return at range r and angle a of a tilted lidar is at r P (cos a, sin a),
        where P is the projection.
        """
        level = -angles if self.upside_down else angles
        if self.projection is None:
            return level, ranges
        x, y = self.projection @ np.array([np.cos(angles), np.sin(angles)])
        change = np.arctan2(y, x) - level  # from the level angle, which may be of any turn
        return level + np.arctan2(np.sin(change), np.cos(change)), ranges * np.hypot(x, y)


def ranges_of(message: Any) -> Floats:
    """Return the ranges (n,) of a LaserScan in the order and unit of the message."""
    with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaNs
        return np.asarray(message.ranges, dtype=np.float64)


def odometry_of(message: Any, received: int) -> Odometry:
    """Convert an Odometry; `received` is the time of reception, nanoseconds. Raises ValueError if it is invalid."""
    return Odometry(stamp_of(message.header, received), planar_pose(message.pose.pose))


def yaw_rate_of(message: Any, received: int, axis: Floats) -> YawRate:
    """Convert an Imu; raises ValueError if it contains no valid rates.

    received  time of reception, nanoseconds
    axis      (3,) direction of the base's z axis in the frame of the message
    """
    rates = message.angular_velocity
    rate = float(axis @ np.array([rates.x, rates.y, rates.z]))
    if message.angular_velocity_covariance[0] == -1.0 or not abs(rate) < MAX_RATE:
        raise ValueError("no valid angular velocity")
    return YawRate(stamp_of(message.header, received), rate)


def scan_of(message: Any, received: int, mount: LidarMount, per_metre: float = 1.0) -> Scan:
    """Convert a LaserScan to a Scan; raises ValueError if it is invalid.

    Ranges outside of the stated limits become NaN. Angles increase: a scan that is measured clockwise, or by a lidar
    that is mounted upside down, is reversed together with its time offsets. For a tilted lidar, see `LidarMount`.

    received   time of reception, nanoseconds; the stamp if the header has none
    per_metre  units of the ranges in a metre; the limits have the same unit if they are beyond any range in metres
    """
    ranges = ranges_of(message) / per_metre
    count, start, step = len(ranges), message.angle_min, message.angle_increment
    if count == 0:
        raise ValueError("no beams")
    if not (abs(start) < 100.0 and abs(step) * count <= MAX_SPAN) or (abs(step) < MIN_ANGLE_STEP and count > 1):
        raise ValueError("angles are invalid")
    low = message.range_min if message.range_min > 0.0 else 0.0
    low, high = _limits(low, message.range_max if message.range_max > low else math.inf, per_metre)
    valid = (ranges > 0.0) & (ranges >= low) & (ranges < high)  # false for nan
    ranges = np.where(valid, ranges, np.nan)
    delay = message.time_increment
    offsets = _steps(0.0, delay if 0.0 < delay * count < 2.0 else 0.0, count)
    angles, ranges = mount.seen_from_above(_steps(start, step, count), ranges)
    strengths = intensities_of(message)
    if count > 1 and angles[1] < angles[0]:
        angles, ranges, offsets = angles[::-1].copy(), ranges[::-1].copy(), offsets[::-1].copy()
        strengths = None if strengths is None else strengths[::-1].copy()
    stamp = stamp_of(message.header, received)
    return Scan(stamp, ranges, angles, offsets, low, high, mount.pose, intensities=strengths)


def _limits(low: float, high: float, per_metre: float) -> tuple[float, float]:
    """Return the limits of ranges in metres; they are in metres already unless they are beyond any range in metres."""
    return (low / per_metre, high / per_metre) if high > FAR else (low, high)


def intensities_of(message: Any) -> Floats | None:
    """Return the intensities of a LaserScan; None if it does not have one for each beam."""
    found = np.asarray(message.intensities, dtype=np.float64)
    return found if len(found) == len(message.ranges) else None


def exact_scan_of(message: Any, stamp: float, mount: Pose | None, per_metre: float = 1.0) -> Scan:
    """Convert a BEAMS message to a Scan, see `scan_of`; raises ValueError if it is invalid."""
    data = np.array(message.data, dtype=np.float64)
    if len(data) < 5 or (len(data) - 2) % 3:
        raise ValueError("exact beams are incomplete")
    angles, ranges, offsets = data[2:].reshape(3, -1)
    if not (np.all(np.diff(angles) > 0) and np.ptp(angles) <= MAX_SPAN and np.all(np.isfinite(offsets))):
        raise ValueError("exact beams are not in order")
    return Scan(stamp, ranges / per_metre, angles, offsets, *_limits(float(data[0]), float(data[1]), per_metre), mount)
