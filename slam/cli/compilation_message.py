"""Message while numba compiles; importing this module imports numba."""

from __future__ import annotations

import time
from threading import Timer

from numba.core.event import Event, Listener

from .console import SLOW_SECONDS, print_message


class CompilationMessage(Listener):
    """Listener to numba's compilations that prints a message when they have taken SLOW_SECONDS together.

    Loading a compiled function from disk is no compilation. Compilations are nested if functions call each other.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._depth, self._started, self._left = 0, 0.0, SLOW_SECONDS
        self._timer: Timer | None = None

    def leave_out(self) -> None:
        """Print no message any more."""
        self._left = 0.0

    def on_start(self, event: Event) -> None:
        """Start to count if no compilation is under way."""
        self._depth += 1
        if self._depth == 1 and self._left > 0.0:
            self._started, self._timer = time.monotonic(), Timer(self._left, print_message, [self._text])
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Event) -> None:
        """Stop to count at the end of the outermost compilation."""
        self._depth -= 1
        if self._depth == 0 and self._timer is not None:
            self._timer.cancel()
            self._timer, self._left = None, self._left - (time.monotonic() - self._started)
