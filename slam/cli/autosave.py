"""Saving the map of a live run while it goes on: every minute, on SIGUSR1, and with a key."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ..errors import MapError, OutputError, first_line
from ..io.output_dir import OutputDirectory
from .console import print_message

PERIOD = 60.0
"""Seconds between two saves: the most that a power failure costs."""
SAVE_KEY = b"s"


class Autosave:
    """Context in which the map is saved every PERIOD, on SIGUSR1 and if the key `s` is pressed.

    output   output directory of the run, entered
    prepare  called between two messages: returns a function that writes the state of that moment into a directory, in
             another thread. Raises MapError if there is nothing to save yet
    """

    def __init__(self, output: OutputDirectory, prepare: Callable[[], Callable[[Path], None]]) -> None:
        self._output, self._prepare = output, prepare
        self._keys = _Keys()
        self._requested = False
        self._due = time.monotonic() + PERIOD
        self._thread: threading.Thread | None = None
        self._problem = ""

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR1, self._request)
            self._output.announce()
        self._keys.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._keys.close()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # one that was sent before must not end the process
        if self._thread is not None:
            self._thread.join()

    def poll(self) -> None:
        """Start to save if that is due or was requested; cheap otherwise. To be called between two messages."""
        self._requested |= self._keys.pressed(SAVE_KEY)
        if self._thread is not None and self._thread.is_alive():
            return
        if not self._requested and time.monotonic() < self._due:
            return
        requested, self._requested = self._requested, False
        self._due = time.monotonic() + PERIOD
        try:
            write = self._prepare()
        except MapError as error:
            if requested:
                problem = f"{self._output.path}: not saved: {error}"
                self._output.announce(problem)
                print_message(problem)
            return
        self._thread = threading.Thread(target=self._save, args=(write, requested), name="autosave")
        self._thread.start()

    def _request(self, *_: Any) -> None:
        self._requested = True

    def _save(self, write: Callable[[Path], None], requested: bool) -> None:
        before, self._problem = self._problem, ""
        try:
            self._output.save(write)
        except OutputError as error:
            self._problem = str(error)
        except Exception as error:  # whatever it is, it must not end the run
            self._problem = f"{self._output.path}: not saved: {first_line(error)}"
        self._output.announce(self._problem)
        if self._problem and (requested or self._problem != before):
            print_message(f"{self._problem}; the run goes on")
        elif requested:
            print_message(f"{self._output.path}: saved")


class _Keys:
    """Keys pressed in the terminal of the process, if it has one in the foreground."""

    def __init__(self) -> None:
        self._before: list[Any] | None = None

    def open(self) -> None:
        """Read keys without waiting for the end of a line."""
        with suppress(OSError, ValueError, termios.error):  # standard input is closed, or no terminal
            self._input = sys.stdin.fileno()
            if os.tcgetpgrp(self._input) == os.getpgrp():  # changing the terminal would stop a background process
                self._before = termios.tcgetattr(self._input)
                tty.setcbreak(self._input)

    def close(self) -> None:
        """Restore the terminal."""
        if self._before is not None:
            with suppress(OSError, termios.error):
                termios.tcsetattr(self._input, termios.TCSANOW, self._before)
            self._before = None

    def pressed(self, key: bytes) -> bool:
        """Return True if a key was pressed since the last call."""
        if self._before is None:
            return False
        with suppress(OSError):
            ready, _, _ = select.select([self._input], [], [], 0.0)
            return bool(ready) and key in os.read(self._input, 256).lower()
        return False
