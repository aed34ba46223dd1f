"""Tell the topics of several robots in one recording apart.

Each robot publishes in a namespace of its own: `/r1/scan` and `/r1/odom`, `/r2/scan` and `/r2/odom`. A namespace with
scans belongs to another robot than that of the lidar, if the lidar's own namespace has what is taken from there. So
a robot with `/front/scan`, `/rear/scan` and one `/odom` keeps its odometry, and one with `/scan`, `/odom` and a camera
with `/camera/scan` and `/camera/imu` its gyroscope.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from .multi_echo import MULTI_ECHO
from .point_clouds import POINT_CLOUD
from .ros_messages import IMU, LASER_SCAN, ODOMETRY, TRANSFORMS, TRANSFORMS_ROS1

SCANS = (LASER_SCAN, MULTI_ECHO, POINT_CLOUD)
"""Types of messages that a lidar publishes."""
ROBOT = (ODOMETRY, IMU, TRANSFORMS, TRANSFORMS_ROS1)
"""Types of messages that a robot publishes about itself."""


def topics_of_other_robots(counts: Mapping[str, Counter[str]], lidar: str | None) -> frozenset[str]:
    """Return the topics with odometry, yaw rates or transforms of other robots than that of the lidar.

    counts  type name -> topic -> number of messages
    lidar   topic of the scans that are read
    """
    if lidar is None:
        return frozenset()
    own = _namespace(lidar)
    others = {_namespace(topic) for kind in SCANS for topic in counts.get(kind, ())} - {own}
    found: set[str] = set()
    for kind in ROBOT:
        topics = counts.get(kind, Counter())
        foreign = {topic for topic in topics if _namespace(topic) in others}
        if any(_namespace(topic) == own for topic in topics):
            found |= foreign
    return frozenset(found)


def _namespace(topic: str) -> str:
    """Return the namespace of a robot, the first of the names of a topic; empty if there is but one name."""
    first, separator, _ = topic.lstrip("/").partition("/")
    return first if separator else ""
