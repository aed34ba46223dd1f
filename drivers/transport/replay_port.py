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

from .byte_capture import FROM_DEVICE, read_lines

ANSWER = 5.0
"""Seconds of waiting for what the tape says that the host sent; then the tape goes on without it."""
OPENING = 60.0
"""Seconds of waiting for somebody to open the port."""
LARGEST = 4096
"""Bytes taken at once."""


class TapePort:
    """Plays a tape from the device's side, a context.

    name   the port to open
    speed  times as fast as it was

    Where the tape says that the host sent something, the tape waits until as many bytes have come, so that questions
    and answers stay in step. Raises RecordingError where the tape cannot be read.
    """

    def __init__(self, path: str | Path, speed: float = 1.0) -> None:
        self._lines = read_lines(path)
        self._speed = speed
        self._heard = 0
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.name = os.ttyname(self._theirs)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._ours)
        os.close(self._theirs)

    def play(self) -> int:
        """Play to the end; the number of bytes that went out. Bytes for which the port has no room are lost, as those
        of a device are.
        """
        count, expected, before = 0, 0, None
        for direction, received in self._lines:
            if before is not None:
                self._listen(time.monotonic() + (received.time - before) / self._speed)
            before = received.time
            if direction == FROM_DEVICE:
                with suppress(BlockingIOError):
                    count += os.write(self._ours, received.data)
            else:
                expected += len(received.data)
                self._listen(time.monotonic() + (ANSWER if self._heard else OPENING), expected)
        return count

    def _listen(self, until: float, expected: int | None = None) -> None:
        """Take what the host sends, until a time, or until as many bytes have come in all as are expected."""
        while expected is None or self._heard < expected:
            left = until - time.monotonic()
            if left <= 0.0:
                return
            ready, _, _ = select.select([self._ours], [], [], left)
            if ready:
                self._heard += len(os.read(self._ours, LARGEST))
