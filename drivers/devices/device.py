"""Interface of a device, and what most devices do alike."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar

from ..errors import NoResponseError
from ..messages import Message
from ..transport import Received, Transport

READ_TIMEOUT = 0.05
"""Seconds. It is always the same because a change reconfigures the serial port."""
READ_PAUSE, PROMPT_READ_PAUSE = 0.01, 0.002
"""Seconds between reads, and if messages are needed promptly. The cost is in the number of reads; the buffers of the
system hold far more than arrives meanwhile.
"""
MAX_DRAIN_DURATION = 1.0
"""Seconds after which a device is assumed to send continuously."""

ResponseT = TypeVar("ResponseT")


class Device(ABC):
    """A device over any number of connections: it is started on each, then stepped, then halted.

    bauds          bits per second to try, in this order
    dtr            state of the modem line DTR while the port is opened
    start_timeout  seconds from the start to the first measurement, and from messages to the next ones, at most
    identity       description by the device itself; empty until it was identified
    serial         serial number; empty if it has none or until it was identified
    required_serial  serial number that the device must have; empty for any
    read_pause     seconds between reads

    All errors raised are DriverErrors.
    """

    bauds: tuple[int, ...]
    dtr = False
    read_pause = READ_PAUSE
    start_timeout = 5.0

    def __init__(self) -> None:
        self.identity = self.serial = ""
        self.required_serial = ""

    @property
    @abstractmethod
    def measurement_count(self) -> int:
        """Undamaged packets or readings received so far; it keeps growing while the device works."""

    @abstractmethod
    def identify(self, transport: Transport, baud: int) -> None:
        """Identify the device without moving anything; raises NoResponseError if it is no device of this kind."""

    @abstractmethod
    def start(self, transport: Transport, baud: int) -> None:
        """Identify the device and make it measure."""

    @abstractmethod
    def feed(self, received: Received) -> list[Message]:
        """Return the messages that the bytes complete, stamped on the host's steady clock."""

    @abstractmethod
    def halt(self, transport: Transport) -> None:
        """Stop all moving parts."""

    @abstractmethod
    def counters(self) -> dict[str, int]:
        """Return all counts since the device was created, over all connections."""

    def step(self, transport: Transport) -> tuple[Received, list[Message]]:
        """Read once, and pause to limit the load of the host."""
        received = transport.read(READ_TIMEOUT)
        messages = self.feed(received)
        if received.data:
            time.sleep(self.read_pause)
        return received, messages

    def check_serial(self, transport: Transport) -> None:
        """Check the serial number; raises NoResponseError if it is not the required one."""
        if self.required_serial and self.serial.lower() != self.required_serial.lower():
            raise NoResponseError(
                transport.name,
                f"found {self.identity} with the serial number {self.serial or 'unknown'}, not {self.required_serial}",
            )


def drain(transport: Transport) -> None:
    """Discard incoming bytes until none arrive, so that old bytes are not mistaken for a response."""
    received = transport.read(READ_TIMEOUT)
    end = received.time + MAX_DRAIN_DURATION
    while received.data and received.time < end:
        received = transport.read(READ_TIMEOUT)


def await_response(
    transport: Transport, parse: Callable[[bytes], ResponseT | None], timeout: float
) -> tuple[ResponseT, float] | None:
    """Read until `parse`, called with the bytes as they arrive, returns a value; return it and its time.

    Return None after `timeout` seconds.
    """
    received = transport.read(READ_TIMEOUT)
    end = received.time + timeout
    while True:
        if received.data and (response := parse(received.data)) is not None:
            return response, received.time
        if received.time >= end:
            return None
        received = transport.read(READ_TIMEOUT)
