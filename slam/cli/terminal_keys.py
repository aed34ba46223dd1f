"""Keys pressed in the terminal of a live run, read in a thread of its own, so that a busy run does not delay them."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

POLL_PERIOD = 0.05
"""Seconds after which handlers are called if no key is pressed."""
MAX_READ_SIZE = 256
"""Bytes per read."""


class TerminalKeys:
    """Context in which handlers receive the keys of the process's terminal, if it has one and is in its foreground."""

    def __init__(self) -> None:
        self._handlers: list[Callable[[bytes], None]] = []
        self._before: list[Any] | None = None
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def add(self, handle: Callable[[bytes], None]) -> None:
        """Call `handle` with the bytes of pressed keys, and with no bytes every POLL_PERIOD, from the thread."""
        self._handlers.append(handle)

    def __enter__(self) -> Self:
        with suppress(OSError, ValueError, termios.error):  # standard input is closed, or no terminal
            self._input = sys.stdin.fileno()
            if self._is_foreground():  # changing the terminal would stop a background process
                self._before = termios.tcgetattr(self._input)
                tty.setcbreak(self._input)
                self._thread = threading.Thread(target=self._run, name="keys", daemon=True)
                self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        if self._before is not None:
            with suppress(OSError, termios.error):
                termios.tcsetattr(self._input, termios.TCSANOW, self._before)
            self._before = None

    def _is_foreground(self) -> bool:
        return os.tcgetpgrp(self._input) == os.getpgrp()

    def _run(self) -> None:
        with suppress(OSError):  # the terminal is gone
            while not self._over.is_set():
                ready, _, _ = select.select([self._input], [], [], POLL_PERIOD)
                keys = os.read(self._input, MAX_READ_SIZE) if ready and self._is_foreground() else b""
                if ready and not keys:
                    self._over.wait(POLL_PERIOD)  # in the background, where reading would stop the process
                for handle in self._handlers:
                    handle(keys)
