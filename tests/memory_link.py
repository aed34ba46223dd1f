"""Link to a ROS 2 that consists of this process only."""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from typing import Any

from drivers.ros2.link import Answer, Put, QoS, Receive
from drivers.ros2.services import encode_request, service_store


class MemoryLink:
    """A `Link` whose messages are delivered at once, in the thread that publishes them.

    sent      all messages by topic
    received  topics that somebody has subscribed to
    """

    description = "memory"
    serves_services = True

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = defaultdict(list)
        self.received: set[str] = set()
        self.services: dict[str, tuple[str, Answer]] = {}
        self.closed = False
        self.changed = threading.Condition()
        self._receivers: dict[str, list[Receive]] = defaultdict(list)
        self._latched: dict[str, deque[bytes]] = {}

    def publish(self, topic: str, msgtype: str, qos: QoS) -> Put:
        """Advertise a topic."""
        if qos.latched:
            self._latched.setdefault(topic, deque(maxlen=qos.depth))

        def put(data: bytes) -> None:
            with self.changed:
                self.sent[topic].append(data)
                self._latched.get(topic, deque(maxlen=1)).append(data)
                self.changed.notify_all()
            for receive in self._receivers[topic]:
                receive(data)

        return put

    def subscribe(self, topic: str, msgtype: str, qos: QoS, receive: Receive) -> None:
        """Subscribe to a topic; what was latched arrives at once."""
        with self.changed:
            self.received.add(topic)
            self._receivers[topic].append(receive)
            self.changed.notify_all()
        for data in self._latched.get(topic, ()) if qos.latched else ():
            receive(data)

    def serve(self, service: str, srvtype: str, answer: Answer) -> None:
        """Offer a service."""
        self.services[service] = (srvtype, answer)

    def call(self, service: str, **members: object) -> Any:
        """Call a service and return its response."""
        srvtype, answer = self.services[service]
        data = answer(encode_request(srvtype, members))
        return service_store().deserialize_cdr(data, f"{srvtype}_Response")

    def close(self) -> None:
        """Leave."""
        self.closed = True
