"""A byte capture played behind a pseudo terminal, so that any program can read it like the device."""

from __future__ import annotations

import os
import pty
import select
import time
import tty
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from .byte_capture import FROM_DEVICE, read_capture

MAX_HOST_DELAY = 5.0
"""Seconds to wait for bytes that the captured host sent; afterwards the capture continues without them."""
MAX_OPEN_DELAY = 60.0
"""Seconds to wait for a program to open the port."""
MAX_READ_SIZE = 4096
"""Bytes per read."""


class ReplayPort:
    """Player of a byte capture from the device's side; a context manager.

    name   path of the port to open
    speed  factor of the original speed

    Where the captured host sent bytes, playing waits until as many bytes have arrived, so that requests and responses
    stay in step. Raises RecordingError if the capture cannot be read.
    """

    def __init__(self, path: str | Path, speed: float = 1.0) -> None:
        self._chunks = read_capture(path)
        self._speed = speed
        self._received_bytes = 0
        self._controller, self._terminal = pty.openpty()
        tty.setraw(self._terminal)
        os.set_blocking(self._controller, False)
        self.name = os.ttyname(self._terminal)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._controller)
        os.close(self._terminal)

    def play(self) -> int:
        """Play to the end; return the number of bytes sent. Bytes are lost if the port's buffer is full, as with a
        device.
        """
        count, expected, previous = 0, 0, None
        for direction, received in self._chunks:
            if previous is not None:
                self._receive(time.monotonic() + (received.time - previous) / self._speed)
            previous = received.time
            if direction == FROM_DEVICE:
                with suppress(BlockingIOError):
                    count += os.write(self._controller, received.data)
            else:
                expected += len(received.data)
                self._receive(time.monotonic() + (MAX_HOST_DELAY if self._received_bytes else MAX_OPEN_DELAY), expected)
        return count

    def _receive(self, until: float, expected: int | None = None) -> None:
        """Receive the host's bytes until a time, or until `expected` bytes have been received in total."""
        while expected is None or self._received_bytes < expected:
            left = until - time.monotonic()
            if left <= 0.0:
                return
            ready, _, _ = select.select([self._controller], [], [], left)
            if ready:
                self._received_bytes += len(os.read(self._controller, MAX_READ_SIZE))
