"""Receive scans and odometry from ROS 2, as the messages of this project.

Scans wait until the transform from their frame to the base is known, and are dropped if it never is. Messages are
handed on as they arrive, those of each kind in the order of their stamps: a scan arrives when its sweep is over, so it
comes after odometry that was measured later than its stamp. `Slam` needs no other order, and waiting for one would
delay every scan until the next one.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from .. import se2
from ..messages import InitialPose, Message, Odometry, Scan, SourceReport
from ..recordings.point_clouds import POINT_CLOUD, scan_of_cloud
from ..recordings.ros_messages import (
    IMU,
    LASER_SCAN,
    ODOMETRY,
    TRANSFORMS,
    LidarMount,
    decode,
    odometry_of,
    planar_pose,
    scan_of,
    stamp_of,
    yaw_rate_of,
)
from ..recordings.tf_odometry import TransformOdometry
from ..recordings.transforms import TransformTree, normalize_frame
from .encoder import POSE_WITH_COVARIANCE
from .inputs import Inputs
from .link import DEFAULT, MOVING_TRANSFORMS, SENSOR_DATA, STATIC_TRANSFORMS, Link, QoS
from .silence import Silence
from .stamp_check import Refusal, StampCheck

MAX_WAITING_SCANS = 40
"""Scans of each lidar that wait for a busy consumer before the oldest is dropped: some seconds of a common lidar."""

TOO_SLOW = "scans arrive faster than they are processed"
NO_MOUNT = "dropped, as no transform connects the scan's frame with the base"
PAUSED = "dropped while new measurements are paused"
THROTTLED = "dropped by throttle_scans"
WRONG_FRAME = "initial pose in another frame than the map's"


class RosReceiver:
    """Receiver of the messages of a link, from construction until `stop`.

    inputs       what is received
    on_odometry  called with each odometry reading, from a thread of the link
    paused       true: scans are dropped
    report       counts of what was received and dropped
    """

    def __init__(
        self, link: Link, inputs: Inputs, on_odometry: Callable[[Odometry], None] = lambda reading: None
    ) -> None:
        self.report = SourceReport()
        self.paused = False
        self.inputs, self._on_odometry = inputs, on_odometry
        self._tree = TransformTree()
        self._tf_odometry = TransformOdometry(inputs.odometry_frame, inputs.base_frame, self._tree)
        self._mounts: dict[str, LidarMount] = {}
        self._messages: deque[Message] = deque()
        self._waiting, self._scans = 0, [0 for _ in inputs.scan_topics]
        self._reading: Odometry | None = None  # odometry in the message that is being added
        self._stamps = StampCheck(uses_odometry=inputs.uses_odometry)
        self._silence = Silence(len(inputs.scan_topics))
        self._changed, self._stopped = threading.Condition(), False
        subscribe = partial(self._subscribe, link)
        subscribe(inputs.static_transforms, TRANSFORMS, self._add_fixed, STATIC_TRANSFORMS)
        subscribe(inputs.transforms, TRANSFORMS, self._add_moving, MOVING_TRANSFORMS)
        for lidar, topic in enumerate(inputs.scan_topics):
            msgtype = POINT_CLOUD if topic == inputs.cloud else LASER_SCAN
            subscribe(topic, msgtype, partial(self._add_scan, lidar), SENSOR_DATA)
        if inputs.initial_pose:
            subscribe(inputs.initial_pose, POSE_WITH_COVARIANCE, self._add_initial_pose, DEFAULT)
        if inputs.imu:
            subscribe(inputs.imu, IMU, self._add_rate, SENSOR_DATA)
        if inputs.odometry and inputs.uses_odometry and not inputs.base:
            subscribe(inputs.odometry, ODOMETRY, self._add_odometry, SENSOR_DATA)

    def receive(self, timeout: float) -> Message | None:
        """Return the next message; None if there is none within `timeout` seconds or after the end."""
        with self._changed:
            if not self._messages and not self._stopped:
                self._changed.wait(timeout)
            if not self._messages:
                return None
            message = self._messages.popleft()
            self._waiting -= isinstance(message, Scan)
            self.report.messages += 1
            return message

    def add_odometry(self, reading: Odometry) -> None:
        """Add odometry of the node's own base. May be called from any thread."""
        self._add(self._put_odometry, reading)

    @property
    def clock_was_set_back(self) -> bool:
        """True if stamps have begun again, as in a simulation that is reset or a bag that is played again.

        Nothing arrives then until `begin_again`.
        """
        return self._stamps.was_set_back

    @property
    def stopped(self) -> bool:
        """True after `stop`."""
        return self._stopped

    @property
    def ended(self) -> bool:
        """True if no message is left and none will arrive."""
        return self._stopped and not self._messages

    def stop(self) -> None:
        """Receive nothing more; what has arrived can still be fetched."""
        self._stopped = True
        with self._changed:
            self._changed.notify_all()

    def discard(self) -> None:
        """Drop what has arrived and was not fetched yet."""
        with self._changed:
            self._messages.clear()
            self._waiting = 0

    def begin_again(self) -> None:
        """Drop what was not fetched yet, and receive messages of any time."""
        with self._changed:
            self._messages.clear()
            self._waiting = 0
            self._stamps.begin_again()

    def missing(self) -> list[str]:
        """Return what has not arrived for some seconds, one line of text each, or cannot be used."""
        with self._changed:
            lines = self._silence.missing(self.inputs, self._tf_odometry.others)
            return [*lines, *self._stamps.problems(), *self._silence.unusable(self.inputs)]

    def _subscribe(self, link: Link, topic: str, msgtype: str, add: Callable[[Any, int], None], qos: QoS) -> None:
        def receive(data: bytes) -> None:
            try:
                message = decode(data, msgtype, "cdr")
                self._add(add, message, time.time_ns())
            except ValueError as error:
                self._skip(f"{topic}: {error}")

        link.subscribe(topic, msgtype, qos, receive)

    def _add(self, add: Callable[..., None], *arguments: Any) -> None:
        """Call a function that adds a message, and report the odometry that it has added."""
        with self._changed:
            self._reading = None
            add(*arguments)
            reading = self._reading
        if reading is not None:
            self._on_odometry(reading)

    def _add_fixed(self, message: Any, _: int) -> None:
        self._tree.add(message)

    def _add_moving(self, message: Any, received: int) -> None:
        if self.inputs.uses_odometry and not (self.inputs.odometry or self.inputs.base):
            for reading in self._tf_odometry.readings(message, received):
                self._put_odometry(reading)
        if self._silence.unconnected:
            self._tree.add(message)  # older robots publish the mount here

    def _add_odometry(self, message: Any, received: int) -> None:
        """Add an Odometry, whose frame may be another one than the base's if a fixed transform connects them."""
        reading, child = odometry_of(message, received), normalize_frame(message.child_frame_id)
        if child and child != normalize_frame(self.inputs.base_frame):
            offset = self._tree.mount_on(child, self.inputs.base_frame).pose
            reading = reading if offset is None else replace(reading, pose=se2.compose(reading.pose, offset))
        self._put_odometry(reading)

    def _add_initial_pose(self, message: Any, received: int) -> None:
        if message.header.frame_id.lstrip("/") != self.inputs.map_frame:
            self._skip(WRONG_FRAME)
            return
        self._messages.append(InitialPose(stamp_of(message.header, received), planar_pose(message.pose.pose)))
        self._changed.notify()

    def _add_rate(self, message: Any, received: int) -> None:
        axis = self._tree.up_axis(self.inputs.base_frame, message.header.frame_id)
        self._put(yaw_rate_of(message, received, axis))

    def _add_scan(self, lidar: int, message: Any, received: int) -> None:
        self._silence.scan_arrived(lidar)
        self._scans[lidar] += 1
        is_set = self.inputs.second_mount_is_set if lidar else self.inputs.mount_is_set
        mount = self._mount(message.header.frame_id, needed=not is_set)
        if self.paused:
            self._skip(PAUSED)
        elif (self._scans[lidar] - 1) % self.inputs.throttle_scans:
            self._skip(THROTTLED)
        elif mount.pose is None and not is_set:
            self._skip(NO_MOUNT)
        else:
            times = self.inputs.second_beam_times if lidar else self.inputs.beam_times
            self._put(replace(times.of(self._scan_of(message, received, mount)), lidar=lidar))

    def _scan_of(self, message: Any, received: int, mount: LidarMount) -> Scan:
        if not hasattr(message, "point_step"):
            return scan_of(message, received, mount)
        pose = self._tree.pose_on(self.inputs.base_frame, message.header.frame_id)
        return scan_of_cloud(message, received, pose, mount, self.inputs.cut)

    def _mount(self, frame: str, *, needed: bool) -> LidarMount:
        """Return the mount of a scan's frame, which never changes once it is known; report it missing if `needed`."""
        if frame not in self._mounts:
            mount = self._tree.mount_on(self.inputs.base_frame, frame)
            if mount.pose is None:
                if needed:
                    self._silence.unconnected.add(frame)
                return mount
            self._mounts[frame] = mount
            self._silence.unconnected.discard(frame)
        return self._mounts[frame]

    def _put_odometry(self, reading: Odometry) -> None:
        self._silence.odometry_arrived()
        if self._put(reading):
            self._reading = reading

    def _put(self, message: Message) -> bool:
        """Append a message if it follows the last one of its sensor; transforms are often sent twice."""
        if self._stopped:
            return False
        sensor = type(message), message.lidar if isinstance(message, Scan) else 0
        refusal = self._stamps.refuse(sensor, message.stamp, paused=self.paused)
        if refusal is not None:
            if refusal is not Refusal.REPEATED:
                self._skip(refusal)
            return False
        self._messages.append(message)
        if isinstance(message, Scan):
            self._waiting += 1
            if self._waiting > MAX_WAITING_SCANS * len(self._scans):
                self._messages.remove(next(waiting for waiting in self._messages if isinstance(waiting, Scan)))
                self._waiting -= 1
                self._skip(TOO_SLOW)
        self._changed.notify()
        return True

    def _skip(self, reason: str) -> None:
        report = self.report
        report.skipped += 1
        report.reasons[reason] = report.reasons.get(reason, 0) + 1
        report.first = report.first or reason
