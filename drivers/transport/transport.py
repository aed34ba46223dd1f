"""Interface of the connections that carry a device's bytes."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf
from typing import NamedTuple, Protocol

PROMPT_DURATION = 1e-3
"""Seconds from reading the bytes to reading the clock on a host that is not busy. These are a few system calls of about
20 microseconds each.
"""
MAX_READS = 5
"""Maximum number of reads in a row on a host that is never prompt."""
LINE_BUFFER = 4095
"""Bytes of a serial port that Linux makes available at a time, by the size of the buffer of its line discipline, N_TTY.
Further ones wait in the driver; a thread of the kernel moves them there some time after a read.
"""


class Received(NamedTuple):
    """Bytes that had arrived by `time`, in seconds on the host's steady clock (`time.monotonic`); empty after a
    timeout. Not `complete` if further bytes may have arrived by then.

    The steady clock is used because the wall clock can be set while a device is being read. It is the same in all
    processes of a host.
    """

    data: bytes
    time: float
    complete: bool = True


class Transport(Protocol):
    """A connection to a device.

    name  the port as a user writes it

    One thread reads and one writes; they may be the same. `cancel` may be called from any thread. To close a
    connection, call `cancel`, wait for the reader to return, and call `close`. All methods but these two raise
    ConnectionLostError once the connection is gone.
    """

    name: str

    def read(self, timeout: float) -> Received:
        """Return all bytes that have arrived; wait at most `timeout` seconds for the first one."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes; wait until the system has accepted all of them."""
        ...

    def set_dtr(self, asserted: bool) -> bool:
        """Set the modem line "data terminal ready"; return False if the connection has none."""
        ...

    def pulse_rts(self, duration: float) -> bool:
        """Assert the modem line "request to send" for some seconds; return False if the connection has none."""
        ...

    def cancel(self) -> None:
        """Make a waiting read, or else the next one, return at once."""
        ...

    def close(self) -> None:
        """Close the connection. Further calls have no effect."""
        ...


def read_promptly(read: Callable[[], bytes], limit: float = inf) -> Received:
    """Return the bytes available from `read`, which does not wait, with the time at which the last one was available.

    limit  bytes that the system makes available at a time: so many are not complete

    A busy host may suspend the program between reading the bytes and reading the clock. All bytes would then seem to
    have arrived late. The bytes that arrive meanwhile are therefore read too, until one read and its clock reading were
    prompt: then the time of the last bytes is right. If none was, the bytes are not complete.
    """
    data, prompt = b"", False
    for _ in range(MAX_READS):
        before = time.monotonic()
        data += read()
        after = time.monotonic()
        if prompt := after - before < PROMPT_DURATION:
            break
    return Received(data, after, prompt and len(data) < limit)
