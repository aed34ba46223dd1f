"""A tape behind a pseudo terminal, so that any program can read it as if the device were there."""

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
"""Seconds of waiting for what the tape says that the host sent; then the tape goes on without it."""
MAX_OPEN_DELAY = 60.0
"""Seconds of waiting for somebody to open the port."""
MAX_READ_SIZE = 4096
"""Bytes taken at once."""


class ReplayPort:
    """Plays a tape from the device's side, a context.

    name   the port to open
    speed  times as fast as it was

    Where the tape says that the host sent something, the tape waits until as many bytes have come, so that questions
    and answers stay in step. Raises RecordingError where the tape cannot be read.
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
        """Play to the end; the number of bytes that went out. Bytes for which the port has no room are lost, as those
        of a device are.
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
        """Take what the host sends, until a time, or until as many bytes have come in all as are expected."""
        while expected is None or self._received_bytes < expected:
            left = until - time.monotonic()
            if left <= 0.0:
                return
            ready, _, _ = select.select([self._controller], [], [], left)
            if ready:
                self._received_bytes += len(os.read(self._controller, MAX_READ_SIZE))
