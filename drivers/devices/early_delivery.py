"""Delivery of messages as they arrive, to a consumer that needs no other order as long as odometry arrives.

In the order of the stamps, odometry that was measured during a sweep follows the scan, which begins earlier and is
complete only at its end. So the odometry that covers the sweep would be delivered with the next scan, one revolution
late; as it arrives it is a few milliseconds old.

A consumer that processes a scan when odometry covers its sweep computes the same from both orders. The order matters
only if so many scans wait for odometry that the consumer gives up. After a pause of the odometry, its first reading is
therefore delivered in the order of the stamps, after the scans that began before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from threading import Lock

from ..messages import Message, Odometry

MAX_PAUSE = 0.25
"""Seconds between two odometry readings after which the order is restored: a base sends every 15 to 20 ms, and the
fastest lidars measure ten scans in this time.
"""


class EarlyDelivery:
    """Delivery of messages of several devices by `deliver`; the methods may be called from any thread."""

    def __init__(self, deliver: Callable[[Message], None]) -> None:
        self._deliver = deliver
        self._lock = Lock()
        self._last = float("-inf")  # stamp of the last odometry
        self._first: Message | None = None  # first odometry after a pause, until it is delivered
        self._behind: list[Message] = []  # messages that arrived after it

    def arrived(self, messages: Iterable[Message]) -> None:
        """Take messages that have arrived: deliver them, or after a pause keep them until they are in order."""
        with self._lock:
            for message in messages:
                is_odometry = isinstance(message, Odometry)
                if self._first is not None:
                    self._behind.append(message)
                elif is_odometry and message.stamp > self._last + MAX_PAUSE:
                    self._first = message
                else:
                    self._deliver(message)
                self._last = message.stamp if is_odometry else self._last

    def ordered(self, message: Message) -> None:
        """Deliver a message that has arrived before and was kept; called for all in the order of their stamps."""
        with self._lock:
            if message is self._first:
                self._deliver(message)
                self._go_on()
            elif any(message is kept for kept in self._behind):
                self._behind = [kept for kept in self._behind if kept is not message]
                self._deliver(message)

    def dropped(self) -> None:
        """Note that messages were dropped, perhaps one that is waited for."""
        with self._lock:
            self._go_on()

    def _go_on(self) -> None:
        for message in self._behind:
            self._deliver(message)
        self._first, self._behind = None, []
