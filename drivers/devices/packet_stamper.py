"""Stamps of measurements: from the arrival of chunks of bytes to a stamp for every packet."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ..lidars.measurements import Flags, Integers, Measurements
from ..messages import Floats
from ..transport import Received
from .device_clock import DeviceClock

MAX_CHUNKS = 1024
"""Chunks whose arrival time is kept; a packet is decoded at most one packet after its last byte."""
LOSS_DELAY = 0.025
"""Seconds. Adapters delay bytes by 16 ms at most; a read returns all available bytes, however late it is."""
MIN_LATE_READS = 2
"""Late reads in a row before packets are considered lost. A single read may be late because the host was busy between
reading the bytes and reading its clock. Odometry tolerates one wrong stamp, not two.
"""
LOSS_ODDS = 20.0
"""Natural logarithm of the odds against a busy host, above which late reads are a loss. Delays of a busy host are
distributed exponentially, so that reads late by d1, d2, ... in a row have the probability exp(-(d1 + d2 + ...) / mean).
Once in 500 million rows such a row has another cause than a loss.
"""
MEAN_DELAY_READS = 50
"""Reads over which the mean delay is averaged: a second or so, in which the load of a host hardly changes."""
MIN_MEAN_DELAY = 2e-3
"""Seconds; the delay of a read on an idle host, by USB frames of 1 ms and the scheduler."""
SETTLING_SECONDS = 0.5
"""Seconds of a stream, by the device's time, after which its first packets are stamped. The host is busy while devices
start, so all of them may arrive late, and an undelayed one shows by how much.
"""
MIN_SPACING = 1e-6
"""Seconds between two stamps of a device at least; the measurements of the fastest lidar are 30 times as far apart."""


class MonotonicStamps:
    """Filter that keeps the stamps of a device strictly increasing over all its connections.

    A newly fitted clock may show that the last stamps were late, as they are when the host was busy. They have already
    been delivered. The stamps of the next measurements then follow as closely as possible until the clock has caught
    up: they are late as well, by less and less, and never by more than those before.
    """

    def __init__(self) -> None:
        self._last = -math.inf

    def stamps(self, fitted: Floats) -> Floats:
        """Return stamps (n,) of the next measurements, in measuring order, in seconds, at least MIN_SPACING apart.

        fitted  (n,) seconds by the fitted clock
        """
        steps = MIN_SPACING * np.arange(1, len(fitted) + 1)
        earliest = np.maximum.accumulate(np.append(self._last, fitted - steps))[1:] + steps
        stamps: Floats = np.maximum(fitted, earliest)
        if len(stamps):
            self._last = float(stamps[-1])
        return stamps


class PacketCountClock:
    """Clock of a device that sends no time: its packets come at a constant rate, so their number serves as the time.

    period  seconds from packet to packet
    clock   device clock fitted to the host's
    lost    estimated number of packets that never arrived

    Packets lost as a whole do not show in the bytes. They show in that all later packets stay late. A busy host, which
    reads all waiting bytes at once, delays single reads, and more of them the busier it is; therefore the mean delay
    before decides how many late reads in a row are a loss. Reads that are not complete do not count: bytes that have
    waited for long come in several of them, and all are late.
    """

    def __init__(self, period: float) -> None:
        self.clock = DeviceClock(period)
        self.lost = 0
        self._late: dict[float, tuple[float, int]] = {}  # delay and number of the last reads by arrival; all are late
        self._mean_delay = LOSS_DELAY  # of the reads before; unknown at first

    def stamp(self, count: int, arrived: float, *, complete: bool = True) -> float:
        """Return the host's time (seconds) at packet number `count`, the last of the packets decoded at `arrived`.

        complete  False if later packets may have arrived by then
        """
        stamp = self.clock.stamp(count, arrived)
        if not complete:
            return stamp
        if arrived - stamp < LOSS_DELAY:
            for delay in (*(delay for delay, _ in self._late.values()), arrived - stamp):
                self._mean_delay += (max(delay, MIN_MEAN_DELAY) - self._mean_delay) / MEAN_DELAY_READS
            self._late.clear()
            return stamp
        # The delay of a read is that of its last packet, which may be decoded only after the next read.
        self._late[arrived] = arrived - stamp, count
        if (
            len(self._late) < MIN_LATE_READS
            or sum(delay for delay, _ in self._late.values()) < LOSS_ODDS * self._mean_delay
        ):
            return stamp
        # The read that is late by least shows the loss; the others were delayed by the host as well.
        shown_at, (lost, number) = min(self._late.items(), key=lambda read: read[1])
        self.lost += round(lost / self.clock.tick)
        self._late.clear()
        self.clock.register_jump()
        self.clock.stamp(number, shown_at)
        return self.clock.stamp(count, arrived)


class _Held(NamedTuple):
    """Measurements that wait until the clock has settled.

    times      (m,) of the packets, units of the clock
    arrivals   (m,) seconds
    undelayed  (m,) stamps of the packets by the clock when they arrived, seconds
    """

    measurements: Measurements
    times: Floats | Integers
    arrivals: Floats
    undelayed: Floats

    def restamped(self, clock: DeviceClock) -> Floats:
        """Return stamps (m,) of the packets by the settled clock, seconds.

        If the stated period of the packets is wrong, the clock may put them after their arrival; stamps must increase,
        so all later ones would follow.
        """
        return np.minimum(clock.host_times(self.times), self.arrivals)


class PacketStamper:
    """Stamps for the packets of one stream.

    period  seconds from packet to packet
    size    bytes of a packet

    Packets with a device time are stamped by it. Other packets are counted: the bytes between two packets give the
    number of damaged ones.
    """

    def __init__(self, period: float, size: int) -> None:
        self._size = size
        self._device_clock = DeviceClock(1.0)  # for packets with a device time in seconds
        self._count_clock = PacketCountClock(period)
        self._fed = 0
        # Of each chunk the bytes fed up to its end, its arrival, and whether it was complete.
        self._chunks: deque[tuple[int, float, bool]] = deque(maxlen=MAX_CHUNKS)
        self._last_end: int | None = None
        self._number = 0  # number of the last packet
        self._damaged = 0
        self._settled = False
        self._held: list[_Held] = []

    def counters(self) -> dict[str, int]:
        """Return the numbers of damaged or missing packets and the events of the clocks."""
        clocks = (self._device_clock, self._count_clock.clock)
        return {
            "packets_lost": self._damaged + self._count_clock.lost,
            "clock_jumps": sum(clock.jumps for clock in clocks),
            "clock_strays": sum(clock.strays for clock in clocks),
        }

    def add_chunk(self, received: Received) -> None:
        """Store the size and arrival of a chunk before it is decoded."""
        self._fed += len(received.data)
        self._chunks.append((self._fed, received.time, received.complete))

    def add(self, measurements: Measurements) -> list[tuple[Measurements, Floats]]:
        """Return measurements with the stamps (n,) of their samples, in seconds on the host's steady clock.

        In the first SETTLING_SECONDS of the stream these are none, and then all since it began.
        """
        packets = measurements.packets
        if not len(packets):
            return []
        arrivals, complete = self._arrivals(packets["end"])
        has_device_time = not np.isnan(packets["device_time"]).any()
        times = packets["device_time"] if has_device_time else self._packet_numbers(packets["end"])
        clock = self._device_clock if has_device_time else self._count_clock.clock
        undelayed = self._undelayed(times, arrivals, None if has_device_time else complete)
        self._held.append(_Held(measurements, times, arrivals, undelayed))
        self._settled |= bool((times[-1] - self._held[0].times[0]) * clock.tick >= SETTLING_SECONDS)
        if not self._settled:
            return []
        restamped = len(self._held) > 1 and not clock.jumps
        ready = [(held.measurements, held.restamped(clock) if restamped else held.undelayed) for held in self._held]
        self._held.clear()
        return [(measurements, measurements.stamps(at)) for measurements, at in ready]

    def _undelayed(self, times: Floats | Integers, arrivals: Floats, complete: Flags | None) -> Floats:
        """Return when the packets (m,) would have arrived without delay, as far as the clock is known.

        complete  (m,) whether all bytes that had arrived with a packet were read; None: `times` are the device's
        """
        clock = self._device_clock if complete is None else self._count_clock.clock
        undelayed = np.empty(len(times))
        # Of packets that arrived together the last one was delayed least; the others are computed from it.
        group_ends = np.flatnonzero(np.append(arrivals[1:] != arrivals[:-1], True))
        first = 0
        for last in group_ends.tolist():
            arrived = float(arrivals[last])
            stamp = (
                clock.stamp(float(times[last]), arrived)
                if complete is None
                else self._count_clock.stamp(int(times[last]), arrived, complete=bool(complete[last]))
            )
            group = slice(first, last + 1)
            undelayed[group] = stamp - (times[last] - times[group]) * clock.tick * (1.0 + clock.drift)
            first = last + 1
        return undelayed

    def _arrivals(self, ends: Integers) -> tuple[Floats, Flags]:
        """Return arrival times of the chunks that contain the packets' last bytes, and whether they are complete."""
        chunk_ends, times, complete = map(np.array, zip(*self._chunks, strict=True))
        rows = np.minimum(np.searchsorted(chunk_ends, ends), len(times) - 1)
        for _ in range(int(rows[-1])):
            self._chunks.popleft()
        return np.asarray(times[rows]), np.asarray(complete[rows])

    def _packet_numbers(self, ends: Integers) -> Integers:
        """Return the packets' numbers, counting the damaged ones in between."""
        before = np.empty_like(ends)
        before[0] = ends[0] - self._size if self._last_end is None else self._last_end
        before[1:] = ends[:-1]
        steps = np.maximum(1, np.rint((ends - before) / self._size)).astype(np.int64)
        self._last_end = int(ends[-1])
        numbers = self._number + np.cumsum(steps)
        self._number = int(numbers[-1])
        self._damaged += int(steps.sum()) - len(steps)
        return np.asarray(numbers)
