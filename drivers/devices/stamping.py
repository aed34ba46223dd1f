"""When measurements were taken: from the arrival of chunks of bytes to a stamp for every packet."""

from __future__ import annotations

from collections import deque
from itertools import accumulate

import numpy as np

from ..device_clock import DeviceClock
from ..lidars.records import Integers, Measurements, Records
from ..messages import Floats
from ..transport import Received

MOST_CHUNKS = 1024
"""Chunks whose arrival is remembered; a packet is known one packet after its last byte at most."""


class PacketStamper:
    """Stamps the packets of one stream.

    period  seconds from packet to packet
    size    bytes of a packet
    clock   the device's clock against the host's

    Packets that tell the device's time are stamped by it. The others are their own clock: they come at a constant rate,
    and the bytes between two tell how many were lost there, however these were damaged.
    """

    def __init__(self, period: float, size: int) -> None:
        self._period, self._size = period, size
        self.clock = DeviceClock(1.0)
        self._fed = 0
        self._chunks: deque[tuple[int, float]] = deque(maxlen=MOST_CHUNKS)  # bytes fed up to its end, arrival
        self._last_end: int | None = None
        self._count = 0  # packets from the first one to the last one, lost ones included

    def note(self, received: Received) -> None:
        """Remember a chunk that is about to be decoded."""
        self._fed += len(received.data)
        self._chunks.append((self._fed, received.time))

    def stamps(self, measurements: Measurements) -> Floats:
        """When the samples (n,) were measured, in seconds on the host's steady clock."""
        packets = measurements.packets
        if not len(packets):
            return np.empty(0)
        arrivals = self._arrivals(packets["end"])
        times = self._device_times(packets)
        undelayed = np.empty(len(packets))
        # Of the packets that arrived together the last one was held up least; the others follow from it.
        lasts = np.flatnonzero(np.append(np.diff(arrivals) != 0.0, True))
        first = 0
        for last in lasts.tolist():
            stamp = self.clock.stamp(float(times[last]), float(arrivals[last]))
            group = slice(first, last + 1)
            undelayed[group] = stamp - (times[last] - times[group]) * (1.0 + self.clock.drift)
            first = last + 1
        return measurements.stamps(undelayed)

    def _arrivals(self, ends: Integers) -> Floats:
        """When the chunks arrived that hold the packets' last bytes."""
        chunk_ends = np.array([end for end, _ in self._chunks])
        times = np.array([time for _, time in self._chunks])
        rows = np.minimum(np.searchsorted(chunk_ends, ends), len(times) - 1)
        for _ in range(int(rows[-1])):
            self._chunks.popleft()
        return np.asarray(times[rows])

    def _device_times(self, packets: Records) -> Floats:
        """Seconds on the device's clock."""
        if not np.isnan(packets["device_time"]).any():
            return np.asarray(packets["device_time"])
        ends = packets["end"]
        before = ends[0] - self._size if self._last_end is None else self._last_end
        steps = np.maximum(1, np.round(np.diff(ends, prepend=before) / self._size)).astype(np.int64)
        self._last_end = int(ends[-1])
        counts = np.fromiter(accumulate(steps.tolist(), initial=self._count), np.int64)[1:]
        self._count = int(counts[-1])
        return np.asarray(counts * self._period)
