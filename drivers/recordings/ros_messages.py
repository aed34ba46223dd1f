"""Conversion between this project's messages and ROS messages, for ROS 1 bags, ROS 2 bags and MCAP files.

`RosEncoder` writes ROS 2 messages in CDR. They are read back bit for bit: headings, because the quaternion is chosen so
that it decodes to the same heading; scans, because values that do not fit into a LaserScan's 32-bit floats are written
to a second message (BEAMS); stamps, if they are whole nanoseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..messages import Floats, GroundTruth, Odometry, Scan
from ..se2 import Pose, wrap
from ..timestamps import NANOSECONDS, to_nanoseconds, to_seconds
from .range_units import FAR

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TRANSFORMS_ROS1 = "tf/msg/tfMessage"
POSE = "geometry_msgs/msg/PoseStamped"
BEAMS = "std_msgs/msg/Float64MultiArray"
"""Exact beams: range_min, range_max, then all angles, all ranges, all time offsets (seconds), as float64."""

MIN_ANGLE_STEP = 1e-6
"""Radians between beams; smaller steps are invalid."""
MAX_ROUNDING_STEPS = 32
"""Limit of the search for a quaternion, units in the last place; a few are sufficient."""

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

BASE_FRAME, ODOMETRY_FRAME, WORLD_FRAME = "base_link", "odom", "world"


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
    if not np.all(np.abs(planar) < 1e9):
        raise ValueError("pose is not finite")
    return planar


def quaternion_of(heading: float) -> tuple[float, float]:
    """Return z and w of a quaternion that `heading_of` decodes to exactly this heading in [-pi, pi).

    Sine and cosine of the half angle are rounded. If this changes the last bit of the heading, the smaller of the two,
    whose resolution is finer, is moved in units in the last place until it does not, and if that does not help, the
    larger one too. Only headings around 1e-308 may differ by one bit.
    """
    z, w = math.sin(heading / 2), math.cos(heading / 2)
    before = 0.0
    for _ in range(MAX_ROUNDING_STEPS):
        error = heading - 2.0 * math.atan2(z, w)
        if error == 0.0:
            break
        small_sine = abs(z) < abs(w)
        if error * before < 0.0:  # no value of the smaller one decodes exactly: move the larger one
            small_sine = not small_sine
        if small_sine:
            z = math.nextafter(z, math.copysign(math.inf, error * w))
        else:
            w = math.nextafter(w, math.copysign(math.inf, -error * z))
        before = error
    return z, w


@lru_cache(maxsize=256)
def _steps(start: float, step: float, count: int) -> Floats:
    values = start + step * np.arange(count, dtype=np.float64)
    values.flags.writeable = False
    return values


@dataclass(frozen=True, slots=True)
class LidarMount:
    """Mount of a lidar on the robot.

    pose         [x, y, heading] in the base's frame; None if unknown
    upside_down  true if the lidar's z axis points down
    """

    pose: Pose | None = None
    upside_down: bool = False


def ranges_of(message: Any) -> Floats:
    """Return the ranges (n,) of a LaserScan in the order and unit of the message."""
    with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaNs
        return np.asarray(message.ranges, dtype=np.float64)


def scan_of(message: Any, received: int, mount: LidarMount, per_metre: float = 1.0) -> Scan:
    """Convert a LaserScan to a Scan; raises ValueError if it is invalid.

    Ranges outside of the stated limits become NaN. Angles increase: a scan that is measured clockwise, or by a lidar
    that is mounted upside down, is reversed together with its time offsets.

    received   time of reception, nanoseconds; the stamp if the header has none
    per_metre  units of the ranges in a metre; the limits have the same unit if they are beyond any range in metres
    """
    ranges = ranges_of(message) / per_metre
    count, start, step = len(ranges), message.angle_min, message.angle_increment
    if count == 0:
        raise ValueError("no beams")
    if not (abs(start) < 100.0 and abs(step) * count < 100.0) or (abs(step) < MIN_ANGLE_STEP and count > 1):
        raise ValueError("angles are invalid")
    low = message.range_min if message.range_min > 0.0 else 0.0
    high = message.range_max if message.range_max > low else math.inf
    if high > FAR:
        low, high = low / per_metre, high / per_metre
    valid = (ranges > 0.0) & (ranges >= low) & (ranges < high)  # false for nan
    ranges = np.where(valid, ranges, np.nan)
    delay = message.time_increment
    offsets = _steps(0.0, delay if 0.0 < delay * count < 2.0 else 0.0, count)
    angles = _steps(start, step, count)
    if mount.upside_down:
        angles = -angles
    if count > 1 and angles[1] < angles[0]:
        angles, ranges, offsets = angles[::-1].copy(), ranges[::-1].copy(), offsets[::-1].copy()
    return Scan(stamp_of(message.header, received), ranges, angles, offsets, low, high, mount.pose)


def exact_scan_of(message: Any, stamp: float, mount: Pose | None) -> Scan:
    """Convert a BEAMS message to a Scan; raises ValueError if it is invalid."""
    data = np.array(message.data, dtype=np.float64)
    if len(data) < 5 or (len(data) - 2) % 3:
        raise ValueError("exact beams are incomplete")
    angles, ranges, offsets = data[2:].reshape(3, -1)
    if not (np.all(np.diff(angles) > 0) and np.all(np.isfinite(angles)) and np.all(np.isfinite(offsets))):
        raise ValueError("exact beams are not in order")
    return Scan(stamp, ranges, angles, offsets, float(data[0]), float(data[1]), mount)


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """State of a part of the robot, as in a ROS DiagnosticStatus.

    wrong    true if there is a problem
    message  short description of the state
    values   numbers by name
    """

    name: str
    wrong: bool
    message: str
    values: dict[str, int]


class RosEncoder:
    """Serialiser of this project's messages to ROS 2 messages in CDR."""

    def __init__(self) -> None:
        self.store = type_store("cdr")
        self.types: dict[str, Any] = dict(self.store.types)

    def definition(self, msgtype: str) -> str:
        """Return the definition of a message type, including all types that it contains."""
        return str(self.store.generate_msgdef(msgtype, ros_version=2)[0])

    def scan(self, scan: Scan, frame: str) -> bytes:
        """Encode a LaserScan; if it cannot represent the scan exactly, the nearest one with equal steps."""
        count = len(scan.ranges)
        step = (scan.angles[-1] - scan.angles[0]) / max(1, count - 1)
        delay = scan.time_offsets[-1] / max(1, count - 1)
        message = self.types[LASER_SCAN](
            self._header(scan.stamp, frame),
            angle_min=_float32(scan.angles[0]),
            angle_max=_float32(scan.angles[-1]),
            angle_increment=_float32(step),
            time_increment=_float32(delay),
            scan_time=0.0,
            range_min=_float32(scan.range_min),
            range_max=_float32(scan.range_max),
            ranges=scan.ranges.astype(np.float32),
            intensities=np.zeros(0, dtype=np.float32),
        )
        return bytes(self.store.serialize_cdr(message, LASER_SCAN))

    def beams(self, scan: Scan) -> bytes:
        """Encode the exact beams of a scan, see BEAMS."""
        dimension = self.types["std_msgs/msg/MultiArrayDimension"]
        count = len(scan.ranges)
        layout = self.types["std_msgs/msg/MultiArrayLayout"](
            dim=[dimension("angle, range, time offset", 3, 3 * count), dimension("beam", count, count)],
            data_offset=2,
        )
        data = np.concatenate([[scan.range_min, scan.range_max], scan.angles, scan.ranges, scan.time_offsets])
        return bytes(self.store.serialize_cdr(self.types[BEAMS](layout=layout, data=data), BEAMS))

    def odometry(self, odometry: Odometry) -> bytes:
        """Encode an Odometry of BASE_FRAME in ODOMETRY_FRAME."""
        vector, types = self.types["geometry_msgs/msg/Vector3"], self.types
        still = types["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
        unknown = np.zeros(36)
        message = types[ODOMETRY](
            self._header(odometry.stamp, ODOMETRY_FRAME),
            child_frame_id=BASE_FRAME,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](self._pose(odometry.pose), unknown),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](still, unknown),
        )
        return bytes(self.store.serialize_cdr(message, ODOMETRY))

    def ground_truth(self, truth: GroundTruth) -> bytes:
        """Encode a PoseStamped in WORLD_FRAME."""
        message = self.types[POSE](self._header(truth.stamp, WORLD_FRAME), self._pose(truth.pose))
        return bytes(self.store.serialize_cdr(message, POSE))

    def diagnostics(self, stamp: float, diagnostics: Sequence[Diagnostic]) -> bytes:
        """Encode a DiagnosticArray; parts with a problem have the level WARN."""
        pair, status = self.types["diagnostic_msgs/msg/KeyValue"], self.types["diagnostic_msgs/msg/DiagnosticStatus"]
        statuses = [
            status(int(part.wrong), part.name, part.message, "", [pair(k, str(v)) for k, v in part.values.items()])
            for part in diagnostics
        ]
        message = self.types[DIAGNOSTICS](self._header(stamp, ""), statuses)
        return bytes(self.store.serialize_cdr(message, DIAGNOSTICS))

    def mount(self, stamp: float, mount: Pose, frame: str) -> bytes:
        """Encode a TFMessage with the transform of a lidar's frame in BASE_FRAME."""
        x, y, heading = mount.tolist()
        transform = self.types["geometry_msgs/msg/Transform"](
            self.types["geometry_msgs/msg/Vector3"](x, y, 0.0), self._quaternion(heading)
        )
        header = self._header(stamp, BASE_FRAME)
        stamped = self.types["geometry_msgs/msg/TransformStamped"](header, frame, transform)
        return bytes(self.store.serialize_cdr(self.types[TRANSFORMS]([stamped]), TRANSFORMS))

    def _header(self, stamp: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(to_nanoseconds(stamp), NANOSECONDS)
        return self.types["std_msgs/msg/Header"](self.types["builtin_interfaces/msg/Time"](seconds, nanoseconds), frame)

    def _pose(self, pose: Pose) -> Any:
        x, y, heading = pose.tolist()
        point = self.types["geometry_msgs/msg/Point"](x, y, 0.0)
        return self.types["geometry_msgs/msg/Pose"](point, self._quaternion(heading))

    def _quaternion(self, heading: float) -> Any:
        wrapped = heading if -math.pi <= heading < math.pi else float(wrap(heading))
        z, w = quaternion_of(wrapped)
        return self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, z, w)


def _float32(value: float) -> float:
    with np.errstate(over="ignore"):  # values beyond 32 bits become infinite
        return float(np.float32(value))
