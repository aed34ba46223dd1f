"""Signals that end a command: SIGINT (Ctrl-C), SIGTERM, and SIGHUP, sent when the terminal or SSH session is gone."""

from __future__ import annotations

import _thread
import os
import signal
import stat
import sys
import threading
from contextlib import suppress
from typing import Any

SIGNAL_STATUS = 128
"""Exit status of a command ended by a signal, as in shells: this plus the number of the signal."""
REPEAT_DELAY = 0.05
"""Seconds until a signal whose exception was lost is handled again; callbacks that lose exceptions are shorter."""


class SignalExit(SystemExit):
    """Exit of a command by the signal `number`."""

    def __init__(self, number: int) -> None:
        super().__init__(SIGNAL_STATUS + number)
        self.number = number


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end a command. SIGHUP is not among them if the command was started with nohup."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


def exit_on_signals() -> None:
    """Make SIGTERM and SIGHUP end the command with the same cleanup as Ctrl-C.

    Code that is called from C, as compilers do, can raise no exception: Python reports it and goes on. A signal that
    arrives there is handled again a moment later.
    """
    for number in ending_signals():
        if number != signal.SIGINT:
            signal.signal(number, _exit)
    report = sys.unraisablehook

    def repeat(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            _repeat_later(signal.SIGINT)
        elif isinstance(unraisable.exc_value, SignalExit):
            _repeat_later(unraisable.exc_value.number)
        else:
            report(unraisable)

    sys.unraisablehook = repeat


def detach_from_terminal() -> None:
    """Discard further output to a terminal that is gone: writing to it would be an error."""
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        with suppress(OSError):  # closed
            if stat.S_ISCHR(os.fstat(descriptor).st_mode):
                os.dup2(null, descriptor)
    os.close(null)


def _exit(number: int, _: object) -> None:
    if number == signal.SIGHUP:
        detach_from_terminal()
    raise SignalExit(number)


def _repeat_later(number: int) -> None:
    timer = threading.Timer(REPEAT_DELAY, _thread.interrupt_main, [number])
    timer.daemon = True
    timer.start()
