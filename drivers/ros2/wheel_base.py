"""A wheel base that belongs to the node: its odometry is published, and velocities of ROS 2 drive it."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Self

import numpy as np

from .. import se2
from ..devices.acquisition import Acquisition
from ..devices.device_spec import DeviceSpec
from ..devices.driving import DriveLimits
from ..errors import DriverError
from ..messages import Floats, Odometry
from ..recordings.ros_messages import ODOMETRY, TRANSFORMS, decode
from ..timestamps import wall_clock_offset
from .encoder import NodeEncoder
from .link import DEFAULT, MOVING_TRANSFORMS, VELOCITIES, Link
from .receiver import RosReceiver

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
VELOCITY_DURATION = 0.1
"""Seconds over which the published velocity is averaged: single readings differ by single counts of the encoders."""
MIN_CLOCK_STEP = 0.1
"""Seconds by which the wall clock was set if it differs by more; it is corrected by less by changing its rate, and that
of the steady clock with it.
"""
RECEIVE_TIMEOUT = 0.05
"""Seconds after which it is checked whether the receiver was stopped."""


@dataclass(frozen=True, slots=True)
class BaseTopics:
    """Absolute names of the topics of a base, its frames, and whether velocities come as TwistStamped."""

    transforms: str = "/tf"
    odometry: str = "/odom"
    velocity: str = "/cmd_vel"
    odometry_frame: str = "odom"
    base_frame: str = "base_footprint"
    stamped: bool = False


class RosWheelBase:
    """Context in which a base is read, and driven if there are limits.

    receiver  receives the odometry; the base is halted as soon as the receiver is stopped
    driving   limits of the velocities on the topic; None: there is no such topic

    failure   error of the base that ended the receiver, if any

    Odometry is stamped by the wall clock as it is set now, as other nodes stamp their scans.

    Entering raises DriverError if the base does not respond.
    """

    def __init__(
        self, link: Link, spec: DeviceSpec, topics: BaseTopics, receiver: RosReceiver, driving: DriveLimits | None
    ) -> None:
        self.failure: DriverError | None = None
        self._topics, self._receiver = topics, receiver
        self._acquisition = Acquisition([spec], driving=driving)
        self._encoder = NodeEncoder()
        self._recent: deque[Odometry] = deque()
        self._clock_step = 0.0  # seconds by which the wall clock was set since the base was started
        self._thread = threading.Thread(target=self._run, name="base")
        self._put_transform = link.publish(topics.transforms, TRANSFORMS, MOVING_TRANSFORMS)
        self._put_odometry = link.publish(topics.odometry, ODOMETRY, DEFAULT)
        if driving is not None:
            link.subscribe(topics.velocity, TWIST_STAMPED if topics.stamped else TWIST, VELOCITIES, self._drive)

    def __enter__(self) -> Self:
        self._acquisition.__enter__()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._acquisition.stop()
        self._thread.join()
        self._acquisition.close()

    def _drive(self, data: bytes) -> None:
        """Drive at the velocity of a message. A message that is damaged or not finite is no command."""
        try:
            message: Any = decode(data, TWIST_STAMPED if self._topics.stamped else TWIST, "cdr")
            twist = message.twist if self._topics.stamped else message
            self._acquisition.drive(float(twist.linear.x), float(twist.angular.z))
        except (ValueError, DriverError):
            return

    def _run(self) -> None:
        try:
            while not self._acquisition.ended:
                if self._receiver.stopped:
                    self._acquisition.stop()
                message = self._acquisition.receive(RECEIVE_TIMEOUT)
                if isinstance(message, Odometry):
                    reading = self._on_wall_clock(message)
                    self._publish(reading)
                    self._receiver.add_odometry(reading)
        except DriverError as error:
            self.failure = error
        self._receiver.stop()

    def _on_wall_clock(self, reading: Odometry) -> Odometry:
        """Return a reading with its stamp by the wall clock as it is set now."""
        step = wall_clock_offset() - self._acquisition.snapshot.clock_offset
        if abs(step - self._clock_step) > MIN_CLOCK_STEP:
            self._clock_step = step
            self._recent.clear()
        return replace(reading, stamp=reading.stamp + self._clock_step) if self._clock_step else reading

    def _publish(self, reading: Odometry) -> None:
        topics, encoder = self._topics, self._encoder
        transform = encoder.transform(reading.stamp, topics.odometry_frame, topics.base_frame, reading.pose)
        self._put_transform(transform)
        frames = topics.odometry_frame, topics.base_frame
        self._put_odometry(encoder.base_odometry(reading, *frames, self._velocity(reading)))

    def _velocity(self, reading: Odometry) -> Floats:
        """Return the mean velocity (3,) in the base's frame over VELOCITY_DURATION: m/s, m/s, rad/s."""
        recent = self._recent
        recent.append(reading)
        while len(recent) > 2 and recent[1].stamp <= reading.stamp - VELOCITY_DURATION:
            recent.popleft()
        duration = reading.stamp - recent[0].stamp
        return se2.between(recent[0].pose, reading.pose) / duration if duration > 0.0 else np.zeros(3)
