"""Interface of a link to ROS 2: it moves messages that are serialised in CDR, whatever their type.

A link is one ROS 2 node. It is implemented on zenoh, on Cyclone DDS, and on rclpy. All its methods can be called from
any thread; callbacks come from threads of the link.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

Put: TypeAlias = Callable[[bytes], None]
"""Function that publishes one serialised message."""
Receive: TypeAlias = Callable[[bytes], None]
"""Function that is called with each serialised message."""
Answer: TypeAlias = Callable[[bytes], bytes]
"""Function from a serialised request to its serialised response."""


@dataclass(frozen=True, slots=True)
class QoS:
    """Quality of service of a topic, as in ROS 2 (history: keep last).

    depth     number of messages that are kept
    reliable  true: lost messages are sent again; false: best effort
    latched   true: durability transient local, late subscribers receive the last `depth` messages
    """

    depth: int = 10
    reliable: bool = True
    latched: bool = False


SENSOR_DATA = QoS(depth=50, reliable=False)
"""Of scans and odometry. It is compatible with publishers of either reliability. ROS 2's own depth of 5 loses scans of
a fast lidar whenever the computer is busy for an eighth of a second.
"""
MOVING_TRANSFORMS = QoS(depth=100)
"""Of /tf, as in tf2."""
STATIC_TRANSFORMS = QoS(depth=100, latched=True)
"""Of /tf_static, which every publisher latches."""
LATCHED = QoS(depth=1, latched=True)
"""Of maps, as Nav2 expects them."""
VELOCITIES = QoS(depth=1, reliable=False)
"""Of velocities to drive, received from publishers of either reliability. Lost ones are not sent again: after a fault
of the network the robot would drive at velocities of the past.
"""
DEFAULT = QoS()


class Link(Protocol):
    """Link to ROS 2 as one node.

    description      name and version of what the link is made of, for one line of text
    serves_services  false if `serve` is not possible
    """

    description: str
    serves_services: bool

    def publish(self, topic: str, msgtype: str, qos: QoS) -> Put:
        """Advertise an absolute topic of a type, for example nav_msgs/msg/Odometry; return the function that sends."""
        ...

    def subscribe(self, topic: str, msgtype: str, qos: QoS, receive: Receive) -> None:
        """Call `receive` with each message of an absolute topic."""
        ...

    def serve(self, service: str, srvtype: str, answer: Answer) -> None:
        """Offer an absolute service of a type, for example nav_msgs/srv/GetMap, of which `type_store` has the request
        and the response. Raises DriverError if that is not possible.
        """
        ...

    def close(self) -> None:
        """Leave ROS 2; nothing is received afterwards."""
        ...


def mangled_type(name: str) -> str:
    """Return the name of a ROS type in DDS and zenoh: sensor_msgs::msg::dds_::LaserScan_."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"
