"""Contents of a recording of ROS messages, found in a pass before it is read: topics, transforms, samples of scans."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from ..messages import Floats
from .no_returns import SpreadSample, find_no_return
from .ros_messages import LASER_SCAN, ODOMETRY, TRANSFORMS, TRANSFORMS_ROS1, LidarMount, decode, scan_of
from .sensor_clocks import SensorClocks
from .stored_messages import StoredMessage
from .transforms import TransformTree

MAX_TF_MESSAGES = 1000
"""Messages on /tf that are searched for the lidar's mount, which older robots publish there repeatedly."""
TF_STRIDE = 20
"""Later ones of which one is read, to see whether the mount moves."""


@dataclass(slots=True)
class Contents:
    """Topics and transforms of a recording, found by `survey`.

    counts     type name -> topic -> number of messages
    fixed      static transforms
    all        static transforms and those on /tf
    base       frame that the odometry moves
    scans      topic -> some of its scans
    clocks     of all sensors
    """

    counts: dict[str, Counter[str]] = field(default_factory=dict)
    fixed: TransformTree = field(default_factory=TransformTree)
    all: TransformTree = field(default_factory=TransformTree)
    base: str | None = None
    scans: dict[str, SpreadSample[StoredMessage]] = field(default_factory=dict)
    clocks: SensorClocks = field(default_factory=SensorClocks)

    def sample(self, topic: str | None) -> list[tuple[Any, int]]:
        """Return some LaserScans of a topic, spread over the recording, with their times of reception (nanoseconds)."""
        decoded = []
        for stored in self.scans[topic].items if topic in self.scans else ():
            with suppress(ValueError):  # counted when the recording is read
                decoded.append((decode(stored.data, LASER_SCAN, stored.encoding), stored.received))
        return decoded

    def find_no_return(self, topic: str | None, per_metre: float) -> float:
        """Return the smallest range (metres) of a topic's scans that stands for a no-return, infinity if there is none.

        per_metre  units of the topic's ranges in a metre
        """
        ranges = []
        for message, received in self.sample(topic):
            with suppress(ValueError):
                ranges.append(scan_of(message, received, LidarMount(), per_metre).ranges)
        found = find_no_return(ranges)
        return math.inf if found is None else found

    def find_pose(self, frame: str) -> Floats | None:
        """Return the pose (4, 4) of a lidar's frame on the base, preferably from static transforms only."""
        poses = (tree.find_pose(frame, self.base) for tree in (self.fixed, self.all))
        return next((pose for pose in poses if pose is not None), None)

    def find_mount(self, frame: str) -> LidarMount:
        """Return the mount of a lidar's frame, preferably from static transforms only."""
        for tree in (self.fixed, self.all):
            mount = tree.find_mount(frame, self.base)
            if mount.pose is not None:
                return mount
        return LidarMount()

    def defect_of(self, frame: str) -> str:
        """Return why a lidar with a frame does not measure in one horizontal plane, as text; empty if it does."""
        if self.all.moves(frame, self.base):
            return "of a lidar that moves on the robot"
        tilt = self.find_mount(frame).tilt
        return f"of a lidar that is tilted by {math.degrees(tilt):.0f} degrees" if tilt else ""


def survey(messages: Iterable[StoredMessage]) -> Contents:
    """Return the contents of a recording with these messages; those that cannot be decoded are only counted."""
    contents = Contents()
    tf_messages = 0
    for stored in messages:
        counts = contents.counts.setdefault(stored.msgtype, Counter())
        counts[stored.topic] += 1
        contents.clocks.add(stored)
        try:
            if stored.msgtype in (TRANSFORMS, TRANSFORMS_ROS1):
                fixed = stored.topic.endswith("tf_static")
                tf_messages += not fixed
                if fixed or tf_messages <= MAX_TF_MESSAGES or tf_messages % TF_STRIDE == 0:
                    message = decode(stored.data, stored.msgtype, stored.encoding)
                    contents.all.add(message)
                    if fixed:
                        contents.fixed.add(message)
            elif stored.msgtype == LASER_SCAN:
                contents.scans.setdefault(stored.topic, SpreadSample()).add(stored)
            elif stored.msgtype == ODOMETRY and contents.base is None:
                contents.base = decode(stored.data, ODOMETRY, stored.encoding).child_frame_id or None
        except ValueError:
            continue  # counted when the recording is read; a transform that cannot be decoded leaves the mount unknown
    contents.clocks.separate_sources()
    return contents
