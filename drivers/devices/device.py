"""What a session needs of a device, and what most devices do alike."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar

from ..errors import NoResponseError
from ..messages import Message
from ..transport import Received, Transport

READ_TIMEOUT = 0.05
"""Seconds; always the same, because a change configures a serial port anew."""
READ_PAUSE = 0.01
"""Seconds between reads. What costs is the number of reads; the buffers of the system hold far more than this."""
MAX_DRAIN_DURATION = 1.0
"""Seconds after which a device is taken to send without end."""

AnswerT = TypeVar("AnswerT")


class Device(ABC):
    """A device over any number of connections: it is started on each, then stepped, then halted.

    bauds     bits a second to try, in this order
    dtr       how the line is set while the port is opened
    patience  seconds from the start to the first measurement
    identity  what it says that it is; empty until it was identified
    serial    its serial number; empty where it has none, or until it was identified
    units     undamaged packets or readings so far; a device that lives counts on

    What it raises are DriverErrors.
    """

    bauds: tuple[int, ...]
    dtr = False
    start_timeout = 5.0

    def __init__(self) -> None:
        self.identity = self.serial = ""
        self.required_serial = ""

    @property
    @abstractmethod
    def measurement_count(self) -> int:
        """See above."""

    @abstractmethod
    def identify(self, transport: Transport, baud: int) -> None:
        """Find out who is there, without anything moving; raises NoResponseError where it is not such a device."""

    @abstractmethod
    def start(self, transport: Transport, baud: int) -> None:
        """Identify it and make it measure."""

    @abstractmethod
    def feed(self, received: Received) -> list[Message]:
        """The messages that bytes complete, stamped on the host's steady clock."""

    @abstractmethod
    def halt(self, transport: Transport) -> None:
        """Make everything stand still that moves."""

    @abstractmethod
    def counters(self) -> dict[str, int]:
        """What was counted since the device was made, over all connections."""

    def step(self, transport: Transport) -> tuple[Received, list[Message]]:
        """Read once, and pause as long as is good for the host."""
        received = transport.read(READ_TIMEOUT)
        messages = self.feed(received)
        if received.data:
            time.sleep(READ_PAUSE)
        return received, messages

    def check_serial(self, transport: Transport) -> None:
        """Raises NoResponseError where another one of the kind answers than the one that is wanted."""
        if self.required_serial and self.serial.lower() != self.required_serial.lower():
            raise NoResponseError(
                transport.name,
                f"found {self.identity} with the serial number {self.serial or 'unknown'}, not {self.required_serial}",
            )


def drain(transport: Transport) -> None:
    """Take what comes until nothing does, so that an answer is not looked for among old bytes."""
    received = transport.read(READ_TIMEOUT)
    end = received.time + MAX_DRAIN_DURATION
    while received.data and received.time < end:
        received = transport.read(READ_TIMEOUT)


def await_answer(
    transport: Transport, parse: Callable[[bytes], AnswerT | None], timeout: float
) -> tuple[AnswerT, float] | None:
    """Read until `take`, given the bytes as they come, returns something: that and its time. None after the timeout
    (seconds).
    """
    received = transport.read(READ_TIMEOUT)
    end = received.time + timeout
    while True:
        if received.data and (answer := parse(received.data)) is not None:
            return answer, received.time
        if received.time >= end:
            return None
        received = transport.read(READ_TIMEOUT)
