"""Receiving of messages in a thread of its own, so that each is seen when it arrives, however busy the run is."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from drivers.errors import DriverError
from drivers.realtime import request_realtime_priority

from .acquisition_loop import RECEIVE_TIMEOUT, Receiver

if TYPE_CHECKING:
    from drivers.messages import Message

CAPACITY = 2000
"""Messages that wait for the run, half a minute; beyond, they wait where they come from and are seen later."""


class MessagePump:
    """A `Receiver` between another one and its consumer; a context manager.

    arrived  called with each message when it arrives, in the thread of the pump
    """

    def __init__(self, receiver: Receiver, arrived: Callable[[Message], None]) -> None:
        self._receiver, self._arrived = receiver, arrived
        self._messages: queue.Queue[Message] = queue.Queue(CAPACITY)
        self._failure: DriverError | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pump", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    @property
    def ended(self) -> bool:
        """True if no message is left and none will arrive."""
        return not self._thread.is_alive() and self._messages.empty() and self._failure is None

    def receive(self, timeout: float) -> Message | None:
        """Return the next message; None if none arrives within `timeout` seconds.

        Raises the DriverError of the other receiver after its last message.
        """
        try:
            return self._messages.get(timeout=timeout if self._thread.is_alive() else 0.0)
        except queue.Empty:
            if self._failure is not None and not self._thread.is_alive():
                failure, self._failure = self._failure, None
                raise failure from None
            return None

    def stop(self) -> None:
        """Stop receiving; messages that were measured so far can still be fetched."""
        self._receiver.stop()

    def _run(self) -> None:
        request_realtime_priority()  # other programs would delay messages; it has little to do for each
        try:
            while not self._receiver.ended and not self._over.is_set():
                message = self._receiver.receive(RECEIVE_TIMEOUT)
                if message is not None:
                    self._arrived(message)
                    self._put(message)
        except DriverError as error:
            self._failure = error

    def _put(self, message: Message) -> None:
        while not self._over.is_set():
            try:
                self._messages.put(message, timeout=RECEIVE_TIMEOUT)
                return
            except queue.Full:
                continue
