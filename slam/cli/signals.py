"""Signals that end a command: SIGINT (Ctrl-C), SIGTERM, and SIGHUP, sent when the terminal or SSH session is gone."""

from __future__ import annotations

import os
import signal
import stat
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Any

SIGNAL_STATUS = 128
"""Exit status of a command ended by a signal, as in shells: this plus the number of the signal."""
REPEAT_DELAY = 0.05
"""Seconds until a signal that could not be handled is handled again; callbacks are shorter."""
COMPILER = "llvmlite"
"""Package that must not be interrupted: LLVM loses exceptions in its callbacks, and would load code without data."""


class SignalExit(SystemExit):
    """Exit of a command by the signal `number`."""

    def __init__(self, number: int) -> None:
        super().__init__(SIGNAL_STATUS + number)
        self.number = number


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end a command. SIGHUP is not among them if the command was started with nohup."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


def exit_at_once() -> None:
    """Make Ctrl-C end the process at once, while there is nothing to save; an exception would be printed."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored
        signal.signal(signal.SIGINT, _end_process)


def _end_process(number: int, frame: FrameType | None) -> None:
    """Handle a signal without an exception: modules that are just imported could lose or report it."""
    os._exit(SIGNAL_STATUS + number)


def exit_on_signals() -> None:
    """Make SIGTERM and SIGHUP end the command with the same cleanup as Ctrl-C.

    Code that is called from C can raise no exception: Python reports it and goes on. A signal that arrives there, or
    while LLVM compiles or loads a function, is handled again a moment later.
    """
    for number in ending_signals():
        if number != signal.SIGINT or signal.getsignal(number) in (signal.default_int_handler, _end_process):
            signal.signal(number, end_command)
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


def end_command(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise KeyboardInterrupt for SIGINT, else SignalExit.

    While LLVM is at work, the signal is handled again a moment later: interrupted there, the process would crash.
    """
    if _is_in_compiler(frame):
        _repeat_later(number)
        return
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    if number == signal.SIGHUP:
        detach_from_terminal()
    raise SignalExit(number)


def _is_in_compiler(frame: FrameType | None) -> bool:
    """Return True if LLVM is at work in a frame or in one of its callers."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] == COMPILER:
            return True
        frame = frame.f_back
    return False


def _repeat_later(number: int) -> None:
    """Send a signal to the main thread in a moment, where it also interrupts a call of the system, such as a wait."""
    timer = threading.Timer(REPEAT_DELAY, signal.pthread_kill, [threading.main_thread().ident, number])
    timer.daemon = True
    timer.start()
