"""Reorder buffer: the messages of several devices in the order of their stamps, in a queue of bounded length."""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import replace
from threading import Condition

from ..messages import Message, end_stamp
from .early_delivery import EarlyDelivery
from .packet_stamper import SETTLING_SECONDS

CAPACITY = 4096
"""Messages that wait for a busy consumer: more than half a minute of a lidar and a wheel base."""
MAX_BATCH = 16
"""Messages per `pop`; popped messages can no longer be dropped."""
MAX_HOLD = 1.5 + SETTLING_SECONDS
"""Seconds that a message waits for earlier messages of another device that is read but sends none; the slowest lidar
turns once in a second, and its first scans wait until its clock has settled.
"""


class ReorderBuffer:
    """Buffer into which the supervisors put messages and from which one thread pops them.

    devices   number of devices that put messages
    offset    seconds to add to stamps on the steady clock
    capacity  maximum number of waiting messages; the oldest are dropped for newer ones
    early     receives the messages that are not late as they arrive, and is to receive those that are popped; None:
              they are only popped

    dropped   messages dropped for lack of room
    late      messages discarded because later ones had been delivered already: from a device that had sent nothing for
              so long that the others no longer waited for it
    """

    def __init__(
        self, devices: int, offset: float, capacity: int = CAPACITY, early: EarlyDelivery | None = None
    ) -> None:
        self.dropped = self.late = 0
        self._early = early
        self._offset, self._capacity = offset, capacity
        self._ends = [float("-inf")] * devices  # end of each device's last message
        self._heap: list[tuple[float, int, Message]] = []
        self._sequence = 0
        self._last = float("-inf")
        self._ready: deque[Message] = deque()
        self._changed = Condition()

    def put(self, device: int, messages: list[Message]) -> None:
        """Add messages of one device, stamped on the steady clock; none may begin before the end of an earlier one."""
        accepted = []
        with self._changed:
            for message in messages:
                self._ends[device] = max(self._ends[device], end_stamp(message))
                if message.stamp < self._last:
                    self.late += 1
                    continue
                shifted = replace(message, stamp=message.stamp + self._offset)
                heapq.heappush(self._heap, (message.stamp, self._sequence, shifted))
                self._sequence += 1
                accepted.append(shifted)
            if self._early is not None:
                self._early.arrived(accepted)  # before they can be popped
            self._release(min(self._ends))
            self._changed.notify()

    def skip(self, device: int, messages: list[Message]) -> None:
        """Note that messages of one device are left out: the others do not wait for them."""
        with self._changed:
            self._ends[device] = max(self._ends[device], *(end_stamp(message) for message in messages))
            self._release(min(self._ends))
            self._changed.notify()

    def pop(self, read_until: float, timeout: float) -> list[Message]:
        """Return up to MAX_BATCH messages that are due; wait at most `timeout` seconds if there are none.

        read_until  time (seconds on the steady clock) up to which all devices have been read and their messages put
        """
        with self._changed:
            self._release(read_until - MAX_HOLD)
            if not self._ready:
                self._changed.wait(timeout)
            return [self._ready.popleft() for _ in range(min(MAX_BATCH, len(self._ready)))]

    def flush(self) -> list[Message]:
        """Return all remaining messages; nothing may be put afterwards."""
        with self._changed:
            self._release(float("inf"))
            messages = list(self._ready)
            self._ready.clear()
            return messages

    def _release(self, until: float) -> None:
        while self._heap and self._heap[0][0] <= until:
            self._last, _, message = heapq.heappop(self._heap)
            self._ready.append(message)
        while len(self._ready) + len(self._heap) > self._capacity:
            if self._ready:
                self._ready.popleft()
            else:
                heapq.heappop(self._heap)
            self.dropped += 1
            if self._early is not None:
                self._early.dropped()
