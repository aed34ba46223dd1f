"""Link to ROS 2 by rclpy, if ROS 2 is sourced."""

from __future__ import annotations

import threading
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions
from rosidl_runtime_py.utilities import get_message, get_service

from ..errors import DriverError
from .link import Answer, Put, QoS, Receive
from .names import NodeNames


class RclpyLink:
    """A `Link` on rclpy, which spins in a thread of its own."""

    serves_services = True

    def __init__(self, names: NodeNames, domain: int) -> None:
        self.description = f"rclpy, domain {domain}"
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(
            names.node, namespace=names.namespace, context=self._context, use_global_arguments=False
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="rclpy", daemon=True)
        self._thread.start()

    def publish(self, topic: str, msgtype: str, qos: QoS) -> Put:
        """Advertise a topic, see `Link`."""
        publisher = self._node.create_publisher(get_message(msgtype), topic, _profile(qos))
        return lambda data: publisher.publish(data)  # bytes are sent as they are

    def subscribe(self, topic: str, msgtype: str, qos: QoS, receive: Receive) -> None:
        """Subscribe to a topic, see `Link`."""
        self._node.create_subscription(get_message(msgtype), topic, receive, _profile(qos), raw=True)

    def serve(self, service: str, srvtype: str, answer: Answer) -> None:
        """Offer a service, see `Link`; raises DriverError if the package of its type is not installed."""
        try:
            kind = get_service(srvtype)
        except (ImportError, AttributeError, LookupError, ValueError) as error:
            raise DriverError(f"{service}: {srvtype} is not installed in ROS 2") from error

        def call(request: Any, _: Any) -> Any:
            return deserialize_message(answer(bytes(serialize_message(request))), kind.Response)

        self._node.create_service(kind, service, call)

    def close(self) -> None:
        """Shut rclpy down."""
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


def _profile(qos: QoS) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
    )
