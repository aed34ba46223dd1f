"""The messages of several devices in the order of their stamps, in a queue that never grows too long."""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import replace
from threading import Condition

from ..messages import Message, end_stamp

CAPACITY = 4096
"""Messages that wait for a consumer that is busy: of a lidar and a base more than half a minute's."""
MAX_BATCH = 16
"""Messages taken at once: what is taken can no longer be dropped."""
MAX_HOLD = 1.5
"""Seconds that a message waits for another device's earlier ones while that is read and sends none; the slowest lidar
turns in a second."""


class ReorderBuffer:
    """Where sessions put messages, and one thread takes them.

    devices   how many put
    offset    seconds to add to stamps on the steady clock
    capacity  messages that wait at most; the oldest are dropped for newer ones

    dropped   messages for which there was no room
    late      messages left out because later ones had been given out already: those of a device from which nothing had
              come for so long that it was no longer waited for
    """

    def __init__(self, devices: int, offset: float, capacity: int = CAPACITY) -> None:
        self.dropped = self.late = 0
        self._offset, self._capacity = offset, capacity
        self._ends = [float("-inf")] * devices  # of what each device sent
        self._heap: list[tuple[float, int, Message]] = []
        self._sequence = 0
        self._last = float("-inf")
        self._ready: deque[Message] = deque()
        self._changed = Condition()

    def put(self, device: int, messages: list[Message]) -> None:
        """Messages of one device, stamped on the steady clock; none begins before the end of one put earlier."""
        with self._changed:
            for message in messages:
                heapq.heappush(self._heap, (message.stamp, self._sequence, message))
                self._sequence += 1
                self._ends[device] = max(self._ends[device], end_stamp(message))
            self._release(min(self._ends))
            self._changed.notify()

    def pop(self, read_until: float, timeout: float) -> list[Message]:
        """A few messages, the next ones that are due when all devices have been read up to a time (seconds on the
        steady clock) and what they sent was put; waits at most a timeout for one where there is none.
        """
        with self._changed:
            self._release(read_until - MAX_HOLD)
            if not self._ready:
                self._changed.wait(timeout)
            return [self._ready.popleft() for _ in range(min(MAX_BATCH, len(self._ready)))]

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
        while len(self._ready) + len(self._heap) > self._capacity:
            if self._ready:
                self._ready.popleft()
            else:
                heapq.heappop(self._heap)
            self.dropped += 1
