"""A serial line: bytes at the pace of a baud rate, and what damages them on the way."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from ..messages import Floats

BITS_PER_BYTE = 10
"""On the line for each byte: start, eight of data, stop."""
MAX_BACKLOG = 0.5
"""Seconds of bytes that a device holds back for a line that is too slow; what is more is lost."""


@dataclass(slots=True)
class _Batch:
    data: bytes
    ends: Floats  # when each packet's last byte is through
    size: int  # of a packet
    consumed: int = 0


class SerialLine:
    """Carries packets one after the other.

    baud      bits a second; infinite for devices that are on USB themselves
    overflow  bytes lost because the line was too slow
    """

    def __init__(self, baud: float) -> None:
        self.baud = baud
        self.overflow = 0
        self._byte_time = BITS_PER_BYTE / baud
        self._batches: deque[_Batch] = deque()
        self._free = 0.0  # when the last byte will be through

    @property
    def due(self) -> float:
        """When all bytes on the way will be through; infinite where there are none."""
        return self._free if self._batches else math.inf

    def send(self, data: bytes, ready: Floats | float) -> None:
        """Put packets of equal size on the line, each when it is `ready`, (m,) or one time."""
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
        """The bytes that have come through since the last call."""
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
        """Lose what is on the way; the number of bytes."""
        lost = sum(len(batch.data) - batch.consumed for batch in self._batches)
        self._batches.clear()
        self._free = time
        return lost


@dataclass(slots=True)
class CorruptionCounts:
    """Bytes dropped, inserted and flipped (one bit each) so far."""

    dropped: int = 0
    inserted: int = 0
    flipped: int = 0


class Corruptor:
    """Damages bytes at random: before a byte another one is inserted, it is dropped, or one of its bits is flipped,
    each with a probability. The damage depends on the seed and not on how the bytes come.
    """

    def __init__(self, drop: float, insert: float, flip: float, random: np.random.Generator) -> None:
        self.counts = CorruptionCounts()
        self._limits = np.cumsum([drop, insert, flip])
        self._positions, self._values = random.spawn(2)

    def __call__(self, data: bytes) -> bytes:
        """The bytes that arrive instead."""
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
