"""The messages of several devices in the order of their stamps, in a queue that never grows too long."""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import replace
from threading import Condition

from ..messages import Message, end_of

CAPACITY = 4096
"""Messages that wait for a consumer that is busy: of a lidar and a base more than half a minute's."""
BATCH = 16
"""Messages taken at once: what is taken can no longer be dropped."""
MARGIN = 0.02
"""Seconds by which a scan may begin before the last one's end, when its clock was fitted anew in between."""
HOLD = 1.5
"""Seconds that a message waits for another device's earlier ones; the slowest lidar turns in a second."""


class Outlet:
    """Where sessions put messages, and one thread takes them.

    devices   how many put
    offset    seconds to add to stamps on the steady clock
    capacity  messages that wait at most; the oldest are dropped for newer ones

    dropped   messages for which there was no room
    late      messages left out because later ones had been given out already
    """

    def __init__(self, devices: int, offset: float, capacity: int = CAPACITY) -> None:
        self.dropped = self.late = 0
        self._offset, self._capacity = offset, capacity
        self._ends = [float("-inf")] * devices  # of what each device sent
        self._heap: list[tuple[float, int, Message]] = []
        self._arrived = 0
        self._last = float("-inf")
        self._ready: deque[Message] = deque()
        self._changed = Condition()

    def put(self, device: int, messages: list[Message]) -> None:
        """Messages of one device in the order of their stamps, on the steady clock."""
        with self._changed:
            for message in messages:
                heapq.heappush(self._heap, (message.stamp, self._arrived, message))
                self._arrived += 1
                self._ends[device] = max(self._ends[device], end_of(message))
            self._release(max(min(self._ends) - MARGIN, max(self._ends) - HOLD))
            self._changed.notify()

    def take(self, now: float, timeout: float) -> list[Message]:
        """A few messages, the next ones that are due by `now` (seconds on the steady clock); waits at most a timeout
        for one where there is none.
        """
        with self._changed:
            self._release(now - HOLD)
            if not self._ready:
                self._changed.wait(timeout)
            return [self._ready.popleft() for _ in range(min(BATCH, len(self._ready)))]

    def flush(self) -> list[Message]:
        """All that is left: nothing will be put any more."""
        with self._changed:
            self._release(float("inf"))
            messages = list(self._ready)
            self._ready.clear()
            return messages

    def _release(self, until: float) -> None:
        while self._heap and self._heap[0][0] <= until:
            stamp, _, message = heapq.heappop(self._heap)
            if stamp < self._last:
                self.late += 1
                continue
            self._last = stamp
            self._ready.append(replace(message, stamp=stamp + self._offset))
        while len(self._ready) > self._capacity:
            self._ready.popleft()
            self.dropped += 1
