"""Link to ROS 2 robots with DDS, the default of ROS 2, on the package cyclonedds.

Topics only: a service call does not work between implementations of DDS by different vendors. CYCLONEDDS_URI
configures Cyclone DDS as usual.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from importlib.metadata import version
from typing import Any

from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ..errors import DriverError
from ..recordings.ros_messages import type_store
from .dds_types import dds_type
from .link import Answer, Put, QoS, Receive

BLOCKING_TIME = 0.1
"""Seconds that a reliable writer may wait for room in its queue, as in ROS 2."""
POLL_PERIOD = 0.1
"""Seconds after which the receiving thread checks for its end."""
BATCH = 64
"""Messages taken at once."""


class DdsLink:
    """A `Link` on Cyclone DDS. Raises DriverError if the domain cannot be joined."""

    serves_services = False

    def __init__(self, domain: int) -> None:
        self.description = f"Cyclone DDS {version('cyclonedds')}, domain {domain}"
        try:
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            raise DriverError(f"Cyclone DDS: {' '.join(str(error).split())}") from error
        self._topics: dict[str, Topic[Any]] = {}
        self._writers: list[DataWriter[Any]] = []  # an entity ends when it is garbage
        self._subscriptions: list[tuple[DataReader[Any], ReadCondition, Receive]] = []
        self._waiting, self._ended = WaitSet(self._participant), threading.Event()
        self._thread = threading.Thread(target=self._receive, name="dds", daemon=True)
        self._thread.start()

    def publish(self, topic: str, msgtype: str, qos: QoS) -> Put:
        """Advertise a topic, see `Link`."""
        writer: DataWriter[Any] = DataWriter(self._participant, self._topic(topic, msgtype), _policies(msgtype, qos))
        self._writers.append(writer)
        kind = dds_type(msgtype)

        def put(data: bytes) -> None:
            with suppress(DDSException):  # no room for BLOCKING_TIME: the message is dropped, as in ROS 2
                writer.write(kind(data))

        return put

    def subscribe(self, topic: str, msgtype: str, qos: QoS, receive: Receive) -> None:
        """Subscribe to a topic, see `Link`."""
        reader: DataReader[Any] = DataReader(self._participant, self._topic(topic, msgtype), _policies(msgtype, qos))
        condition = ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Alive)
        self._subscriptions.append((reader, condition, receive))
        self._waiting.attach(condition)

    def serve(self, service: str, srvtype: str, answer: Answer) -> None:
        """Raise DriverError: see the module."""
        raise DriverError(f"{service}: services are not possible over DDS")

    def close(self) -> None:
        """Leave the domain."""
        self._ended.set()
        self._thread.join()
        self._subscriptions.clear()
        self._writers.clear()
        self._topics.clear()
        del self._waiting, self._participant

    def _receive(self) -> None:
        """Pass on the bytes of all messages, in a thread: a listener of Cyclone DDS must not write."""
        while not self._ended.is_set():
            self._waiting.wait(duration(seconds=POLL_PERIOD))
            for reader, condition, receive in list(self._subscriptions):
                for sample in reader.take(BATCH, condition):
                    receive(sample.data)

    def _topic(self, name: str, msgtype: str) -> Topic[Any]:
        if name not in self._topics:
            self._topics[name] = Topic(self._participant, f"rt{name}", dds_type(msgtype))
        return self._topics[name]


def _policies(msgtype: str, qos: QoS) -> Qos:
    reliability = Policy.Reliability.Reliable(duration(seconds=BLOCKING_TIME))
    return Qos(
        reliability if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        Policy.IgnoreLocal.Participant,
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"typehash={type_store('cdr').hash_rihs01(msgtype)};".encode()),
    )
