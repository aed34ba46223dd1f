"""Receiving messages from running devices or from ROS 2 until a time is over or a signal arrives."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from .console import print_message
from .signals import detach_from_terminal, end_command, ending_signals

if TYPE_CHECKING:
    from drivers.messages import Message

RECEIVE_TIMEOUT = 0.1
"""Seconds to wait for a message before the end of the duration is checked again."""


class Receiver(Protocol):
    """Receiver of messages that arrive while it runs."""

    @property
    def ended(self) -> bool:
        """True if no message is left and none will arrive."""
        ...

    def receive(self, timeout: float) -> Message | None:
        """Return the next message; None if none arrives within `timeout` seconds or the receiver has ended."""
        ...

    def stop(self) -> None:
        """Stop receiving; messages that were measured so far can still be fetched."""
        ...


def receive_messages(receiver: Receiver, seconds: float | None, after_each: Callable[[], None]) -> Iterator[Message]:
    """Yield the messages until the receiver is stopped.

    It is stopped after `seconds`; None: never. `after_each` is called after each message and at least every
    RECEIVE_TIMEOUT. Raises DriverError if devices fail.
    """
    end = float("inf") if seconds is None else time.monotonic() + seconds
    while not receiver.ended:
        message = receiver.receive(RECEIVE_TIMEOUT)
        if message is not None:
            yield message
        after_each()
        if time.monotonic() >= end:
            end = float("inf")
            receiver.stop()


@contextmanager
def stop_on_signals(receiver: Receiver, message: str = "") -> Iterator[None]:
    """Stop the receiver on SIGINT, SIGTERM or SIGHUP and let the block run to its end; a second SIGINT interrupts it.

    `message` is printed when a signal arrives; after that, further SIGTERM and SIGHUP have no effect until the process
    ends. No effect outside the main thread, where signals cannot be handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _: Any) -> None:
        for other in numbers:
            signal.signal(other, end_command if other == signal.SIGINT else signal.SIG_IGN)
        if number == signal.SIGHUP:
            detach_from_terminal()
        receiver.stop()
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
