"""A serial line: bytes at the pace of a baud rate, and their random corruption."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from ..messages import Floats

BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""
MAX_BACKLOG = 0.5
"""Seconds of bytes that a device buffers for a line that is too slow; further bytes are lost."""


@dataclass(slots=True)
class _Batch:
    data: bytes
    ends: Floats  # time at which each packet's last byte is transmitted
    size: int  # of a packet
    consumed: int = 0


class SerialLine:
    """A line that transmits packets one after the other.

    baud      bits per second; infinite for devices with native USB
    overflow  bytes lost because the line was too slow
    """

    def __init__(self, baud: float) -> None:
        self.baud = baud
        self.overflow = 0
        self._byte_time = BITS_PER_BYTE / baud
        self._batches: deque[_Batch] = deque()
        self._free = 0.0  # time at which the last byte will be transmitted

    @property
    def due(self) -> float:
        """Time at which all bytes in transmission will have arrived; infinite if there are none."""
        return self._free if self._batches else math.inf

    def send(self, data: bytes, ready: Floats | float) -> None:
        """Send packets of equal size, each when it is `ready`, (m,) or one time for all."""
        times = np.atleast_1d(np.asarray(ready, dtype=np.float64))
        if self._free - times[-1] > MAX_BACKLOG:
            self.overflow += len(data)
            return
        size = len(data) // len(times)
        duration, index = size * self._byte_time, np.arange(len(times))
        begins = np.maximum.accumulate(np.maximum(times, self._free) - index * duration) + index * duration
        ends = begins + duration
        self._free = float(ends[-1])
        self._batches.append(_Batch(data, ends, size))

    def read(self, time: float) -> bytes:
        """Return the bytes that have arrived since the last call."""
        parts: list[bytes] = []
        while self._batches:
            batch = self._batches[0]
            packets = int(np.searchsorted(batch.ends, time, side="right"))
            through = packets * batch.size
            if packets < len(batch.ends) and self._byte_time > 0.0:
                missing = math.ceil((float(batch.ends[packets]) - time) / self._byte_time)
                through += max(0, batch.size - missing)
            if through > batch.consumed:
                parts.append(batch.data[batch.consumed : through])
                batch.consumed = through
            if through < len(batch.data):
                break
            self._batches.popleft()
        return b"".join(parts)

    def clear(self, time: float) -> int:
        """Discard the bytes in transmission; return their number."""
        lost = sum(len(batch.data) - batch.consumed for batch in self._batches)
        self._batches.clear()
        self._free = time
        return lost


@dataclass(slots=True)
class CorruptionCounts:
    """Numbers of bytes dropped, inserted and flipped (one bit each)."""

    dropped: int = 0
    inserted: int = 0
    flipped: int = 0


class Corruptor:
    """Random corruption of bytes: dropping, inserting a byte before, or flipping one bit, each with a probability.

    The result depends on the seed, not on the chunks.
    """

    def __init__(self, drop: float, insert: float, flip: float, random: np.random.Generator) -> None:
        self.counts = CorruptionCounts()
        self._limits = np.cumsum([drop, insert, flip])
        self._positions, self._values = random.spawn(2)

    def __call__(self, data: bytes) -> bytes:
        """Return the corrupted bytes."""
        if not self._limits[-1] or not data:
            return data
        fate = np.searchsorted(self._limits, self._positions.random(len(data)), side="right")
        hit = np.flatnonzero(fate < 3)
        if not len(hit):
            return data
        damaged, at = bytearray(), 0
        for index in map(int, hit):
            damaged += data[at:index]
            at = index + 1
            extra, bit = (int(value) for value in self._values.integers([256, 8]))
            if fate[index] == 0:
                self.counts.dropped += 1
            elif fate[index] == 1:
                self.counts.inserted += 1
                damaged += bytes([extra, data[index]])
            else:
                self.counts.flipped += 1
                damaged.append(data[index] ^ (1 << bit))
        return bytes(damaged + data[at:])
