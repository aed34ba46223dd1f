"""Receiving messages from running devices until a time is over or a signal arrives."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from .console import print_message
from .signals import detach_from_terminal, ending_signals

if TYPE_CHECKING:
    from drivers.devices.acquisition import Acquisition
    from drivers.devices.snapshot import Snapshot
    from drivers.messages import Message

RECEIVE_TIMEOUT = 0.1
"""Seconds to wait for a message before the snapshot and the end of the duration are checked again."""


def receive_messages(
    acquisition: Acquisition, seconds: float | None, on_snapshot: Callable[[Snapshot], None]
) -> Iterator[Message]:
    """Yield the messages of the devices until they are stopped.

    They are stopped after `seconds`; None: never. `on_snapshot` is called after each message and at least every
    RECEIVE_TIMEOUT. Raises DriverError if the acquisition fails.
    """
    end = float("inf") if seconds is None else time.monotonic() + seconds
    while not acquisition.ended:
        message = acquisition.receive(RECEIVE_TIMEOUT)
        if message is not None:
            yield message
        on_snapshot(acquisition.snapshot)
        if time.monotonic() >= end:
            end = float("inf")
            acquisition.stop()


@contextmanager
def stop_on_signals(acquisition: Acquisition, message: str = "") -> Iterator[None]:
    """Stop the devices on SIGINT, SIGTERM or SIGHUP and let the block run to its end; a second SIGINT interrupts it.

    `message` is printed when a signal arrives; after that, further SIGTERM and SIGHUP have no effect until the process
    ends. No effect outside the main thread, where signals cannot be handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _: Any) -> None:
        for other in numbers:
            signal.signal(other, signal.default_int_handler if other == signal.SIGINT else signal.SIG_IGN)
        if number == signal.SIGHUP:
            detach_from_terminal()
        acquisition.stop()
        if message:
            print_message(message)

    numbers = ending_signals()
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is stop:
                signal.signal(number, handler)
