"""When measurements were taken: from the arrival of chunks of bytes to a stamp for every packet."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ..lidars.measurements import Integers, Measurements
from ..messages import Floats
from ..transport import Received
from .device_clock import DeviceClock

MAX_CHUNKS = 1024
"""Chunks whose arrival is remembered; a packet is known one packet after its last byte at most."""
LOSS_DELAY = 0.025
"""Seconds. Adapters hold back bytes for 16 ms at most; reads take all that is there, however late they are."""
MIN_LATE_READS = 2
"""Reads in a row that are late before packets are taken to be lost; one may be late because the host was busy between
the read and the look at its clock. The odometry forgives one wrong stamp, not two."""
MIN_SPACING = 1e-6
"""Seconds between two measurements of a device at least; those of the fastest lidar are 30 times as far apart."""


class MonotonicStamps:
    """Keeps the stamps of a device from ever running back, over all its connections.

    A clock that is fitted anew may find that its last stamps were late, as they are where the host was busy. They have
    been given out. What was measured next then follows them as closely as it can, until the clock has caught up: its
    stamps are late as well, by less and less, and by no more than those before.
    """

    def __init__(self) -> None:
        self._last = -math.inf

    def stamps(self, fitted: Floats) -> Floats:
        """The stamps (n,) of the next measurements, in the order measured; seconds, CLOSEST apart at least."""
        steps = MIN_SPACING * np.arange(1, len(fitted) + 1)
        earliest = np.maximum.accumulate(np.append(self._last, fitted - steps))[1:] + steps
        stamps: Floats = np.maximum(fitted, earliest)
        if len(stamps):
            self._last = float(stamps[-1])
        return stamps


class PacketCountClock:
    """The clock of a device that tells no time: its packets come at a constant rate, and their number is the time.

    period  seconds from packet to packet
    clock   fitted to the host's
    lost    about how many packets never came

    Packets that are lost whole do not show in the bytes. They show in that all later ones are late and stay so, which a
    host that was busy does not make them: what had to wait is read at once.
    """

    def __init__(self, period: float) -> None:
        self.clock = DeviceClock(period)
        self.lost = 0
        self._late: dict[float, float] = {}  # arrivals of the last reads, all of them late: by how much

    def stamp(self, count: int, arrived: float) -> float:
        """The host's time (seconds) at packet number `count`, known at `arrived`, the last one of those known then."""
        stamp = self.clock.stamp(count, arrived)
        if arrived - stamp < LOSS_DELAY:
            self._late.clear()
            return stamp
        # A read is as late as its last packet, which may be known only when the next read has completed it.
        self._late[arrived] = arrived - stamp
        if len(self._late) < MIN_LATE_READS:
            return stamp
        self.lost += round(min(self._late.values()) / self.clock.tick)
        self._late.clear()
        self.clock.jumped()
        return self.clock.stamp(count, arrived)


class PacketStamper:
    """Stamps the packets of one stream.

    period  seconds from packet to packet
    size    bytes of a packet

    Packets that tell the device's time are stamped by it. The others are counted: the bytes between two tell how many
    were damaged there.
    """

    def __init__(self, period: float, size: int) -> None:
        self._size = size
        self._device_clock = DeviceClock(1.0)  # for packets that tell the time in seconds
        self._count_clock = PacketCountClock(period)
        self._fed = 0
        self._chunks: deque[tuple[int, float]] = deque(maxlen=MAX_CHUNKS)  # bytes fed up to its end, arrival
        self._last_end: int | None = None
        self._number = 0  # of the last packet
        self._damaged = 0

    def counters(self) -> dict[str, int]:
        """Packets that were damaged on the way or never came, and what the clocks met."""
        clocks = (self._device_clock, self._count_clock.clock)
        return {
            "packets_lost": self._damaged + self._count_clock.lost,
            "clock_jumps": sum(clock.jumps for clock in clocks),
            "clock_strays": sum(clock.strays for clock in clocks),
        }

    def add_chunk(self, received: Received) -> None:
        """Remember a chunk that is about to be decoded."""
        self._fed += len(received.data)
        self._chunks.append((self._fed, received.time))

    def stamps(self, measurements: Measurements) -> Floats:
        """When the samples (n,) were measured, in seconds on the host's steady clock."""
        packets = measurements.packets
        if not len(packets):
            return np.empty(0)
        arrivals = self._arrivals(packets["end"])
        has_device_time = not np.isnan(packets["device_time"]).any()
        times = packets["device_time"] if has_device_time else self._packet_numbers(packets["end"])
        clock = self._device_clock if has_device_time else self._count_clock.clock
        undelayed = np.empty(len(packets))
        # Of the packets that arrived together the last one was held up least; the others follow from it.
        group_ends = np.flatnonzero(np.append(arrivals[1:] != arrivals[:-1], True))
        first = 0
        for last in group_ends.tolist():
            arrived = float(arrivals[last])
            stamp = (
                clock.stamp(float(times[last]), arrived)
                if has_device_time
                else self._count_clock.stamp(int(times[last]), arrived)
            )
            group = slice(first, last + 1)
            undelayed[group] = stamp - (times[last] - times[group]) * clock.tick * (1.0 + clock.drift)
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

    def _packet_numbers(self, ends: Integers) -> Integers:
        """The packets' numbers, the damaged ones in between counted."""
        before = np.empty_like(ends)
        before[0] = ends[0] - self._size if self._last_end is None else self._last_end
        before[1:] = ends[:-1]
        steps = np.maximum(1, np.rint((ends - before) / self._size)).astype(np.int64)
        self._last_end = int(ends[-1])
        numbers = self._number + np.cumsum(steps)
        self._number = int(numbers[-1])
        self._damaged += int(steps.sum()) - len(steps)
        return np.asarray(numbers)
