"""What carries a device's bytes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

PROMPT_DURATION = 1e-3
"""Seconds from asking for bytes to having looked at the clock, where nothing else keeps the host busy; these are some
calls of the system, of about 20 microseconds each."""
MAX_READS = 5
"""In a row at most, on a host that is never prompt."""


class Received(NamedTuple):
    """Bytes that had arrived by a time (seconds on the host's steady clock, `time.monotonic`); none after a timeout.

    The steady clock, because the one of the day can be set while a device is being read. It is the same in all
    processes of a host.
    """

    data: bytes
    time: float


class Transport(Protocol):
    """A connection to a device.

    name  the port as a user writes it

    One thread reads and one writes, which may be the same; `cancel` may be called from any. To close, cancel, wait for
    the reader to come back, and close. `read`, `write` and `set_dtr` raise ConnectionLostError once the connection is
    gone.
    """

    name: str

    def read(self, timeout: float) -> Received:
        """All that has arrived; waits at most a timeout (seconds) for the first byte."""
        ...

    def write(self, data: bytes) -> None:
        """Send; waits until the system has taken all bytes."""
        ...

    def set_dtr(self, asserted: bool) -> bool:
        """Set the line "data terminal ready"; False where the connection has none."""
        ...

    def cancel(self) -> None:
        """Make a read that waits, or else the next one, return at once."""
        ...

    def close(self) -> None:
        """Give the port back; any number of times."""
        ...


def read_promptly(read: Callable[[], bytes]) -> Received:
    """What `take` gives, the bytes that are there without waiting for any, with the time when they were.

    A busy host may put the program aside between the bytes and the look at the clock. Then they would all seem to have
    arrived late. So what has come meanwhile is taken, too, until a look was prompt: then the last bytes have their true
    time.
    """
    data = b""
    for _ in range(MAX_READS):
        before = time.monotonic()
        data += read()
        after = time.monotonic()
        if after - before < PROMPT_DURATION:
            break
    return Received(data, after)
