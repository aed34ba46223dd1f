"""Serialise this project's messages as ROS 2 messages in CDR.

They are read back bit for bit: headings, because the quaternion is chosen so that it decodes to the same heading;
scans, because values that do not fit into a LaserScan's 32-bit floats are written to a second message (BEAMS); stamps,
if they are whole nanoseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..messages import GroundTruth, Odometry, Scan, YawRate
from ..se2 import Pose, wrap
from ..timestamps import NANOSECONDS, to_nanoseconds
from .ros_messages import BEAMS, DIAGNOSTICS, IMU, LASER_SCAN, ODOMETRY, POSE, TRANSFORMS, type_store

MAX_ROUNDING_STEPS = 32
"""Limit of the search for a quaternion, units in the last place; a few are sufficient."""

BASE_FRAME, ODOMETRY_FRAME, WORLD_FRAME = "base_link", "odom", "world"


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
            intensities=np.asarray([] if scan.intensities is None else scan.intensities, dtype=np.float32),
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

    def yaw_rate(self, measured: YawRate) -> bytes:
        """Encode an Imu of BASE_FRAME without orientation and acceleration."""
        vector, absent = self.types["geometry_msgs/msg/Vector3"], np.array([-1.0, *np.zeros(8)])
        message = self.types[IMU](
            self._header(measured.stamp, BASE_FRAME),
            orientation=self._quaternion(0.0),
            orientation_covariance=absent,
            angular_velocity=vector(0.0, 0.0, measured.rate),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(0.0, 0.0, 0.0),
            linear_acceleration_covariance=absent,
        )
        return bytes(self.store.serialize_cdr(message, IMU))

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

    def transform(self, stamp: float, parent: str, child: str, pose: Pose) -> bytes:
        """Encode a TFMessage with the transform from a child frame to its parent: the child's pose in the parent."""
        x, y, heading = pose.tolist()
        transform = self.types["geometry_msgs/msg/Transform"](
            self.types["geometry_msgs/msg/Vector3"](x, y, 0.0), self._quaternion(heading)
        )
        stamped = self.types["geometry_msgs/msg/TransformStamped"](self._header(stamp, parent), child, transform)
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
