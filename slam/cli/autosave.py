"""Saving the map of a live run while it goes on: every 45 seconds, on SIGUSR1, and with a key."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from ..errors import MapError, OutputError, first_line
from ..io.output_dir import OutputDirectory
from ..memory import return_code_of_imports, return_freed_memory
from .console import print_message
from .terminal_keys import TerminalKeys

LARGEST_LOSS = 60.0
"""Seconds of the map that a crash may cost: those between the beginnings of two saves, and those that a save takes."""
PERIOD = 45.0
"""Seconds between the beginnings of two saves."""
LARGEST_SHARE = (LARGEST_LOSS - PERIOD) / PERIOD
"""Share of the time that is spent with saving, a third. Only saves that cost more than LARGEST_LOSS are repeated less
often than every PERIOD.
"""
SAVE_KEY = b"s"


class Autosave:
    """Context in which the map is saved on SIGUSR1, by `request`, if the key `s` is pressed, and every PERIOD, or less
    often if a save takes long.

    output   output directory of the run, entered
    prepare  called between two messages: returns a function that writes the state of that moment into a directory, in
             another thread. Raises MapError if there is nothing to save yet
    keys     keys of the terminal

    report   called with the result of each save, also from another thread
    """

    def __init__(
        self, output: OutputDirectory, prepare: Callable[[], Callable[[Path], None]], keys: TerminalKeys
    ) -> None:
        self._output, self._prepare = output, prepare
        keys.add(self._handle_keys)
        self.report: Callable[[str], None] = lambda text: None
        self._requested = False
        self._due = time.monotonic() + PERIOD
        self._thread: threading.Thread | None = None
        self._prepared: Callable[[Path], None] | None = None  # it holds a copy of the run
        self._problem = ""

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR1, lambda *_: self.request())
            self._output.announce(lambda before: before)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # one that was sent before must not end the process
        if self._thread is not None:
            self._thread.join()

    def poll(self) -> None:
        """Start to save if that is due or was requested; cheap otherwise. To be called between two messages."""
        if self._thread is not None and self._thread.is_alive():
            return
        if not self._requested and time.monotonic() < self._due:
            return
        requested, self._requested = self._requested, False
        self._due = time.monotonic() + PERIOD
        began = time.monotonic()
        try:
            self._prepared = self._prepare()
        except Exception as error:  # whatever it is, it must not end the run
            if requested or not isinstance(error, MapError):
                self._conclude(requested, f"{self._output.path}: not saved: {first_line(error)}")
            return
        self._thread = threading.Thread(target=self._save, args=(requested, began), name="autosave")
        self._thread.start()

    def request(self) -> None:
        """Save at the next `poll`. May be called from any thread."""
        self._requested = True

    def _handle_keys(self, keys: bytes) -> None:
        if SAVE_KEY in keys.lower():
            self.request()

    def _save(self, requested: bool, began: float) -> None:
        problem = self._write_prepared()
        return_code_of_imports()  # of the libraries that write tables
        return_freed_memory()  # else what a save has freed stays in gaps between what the run keeps
        took = time.monotonic() - began
        self._due = began + max(PERIOD, took / LARGEST_SHARE)
        self._conclude(requested, problem)

    def _conclude(self, requested: bool, problem: str) -> None:
        """State the result of a save everywhere; `problem` is what was wrong, an empty text if nothing."""
        before, self._problem = self._problem, problem
        self._output.announce(lambda before: replace(before, saves=before.saves + 1, save_problem=problem))
        self.report(problem or f"saved at {time.strftime('%H:%M:%S')}")
        if problem and (requested or problem != before):
            print_message(f"{problem}; the run goes on")
        elif requested:
            print_message(f"{self._output.path}: saved")

    def _write_prepared(self) -> str:
        """Write the prepared state and release it; return what was wrong, an empty text if nothing."""
        write, self._prepared = self._prepared, None
        assert write is not None
        try:
            self._output.save(write)
        except OutputError as error:
            return str(error)
        except Exception as error:  # whatever it is, it must not end the run
            return f"{self._output.path}: not saved: {first_line(error)}"
        return ""
