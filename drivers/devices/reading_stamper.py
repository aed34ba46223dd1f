"""Stamps of the readings of a wheel base, from the arrival of its bytes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..bases import WheelBase, WheelReading
from ..messages import Floats
from .device_clock import MAX_DELAY, DeviceClock
from .packet_stamper import MIN_SPACING, SETTLING_SECONDS, PacketCountClock

MAX_FRAME_SIZE = 256
"""Bytes; more bytes between two readings are not one frame."""


class ReadingStamper:
    """Stamps for the readings of one connection.

    protocol  that of the base. A protocol with a tick but no wrap counts readings instead of measuring time; without a
              tick, readings have the time of their arrival.
    baud      bits per second
    """

    def __init__(self, protocol: WheelBase, baud: int) -> None:
        tick, self._wraps_at, self._baud = protocol.tick, protocol.wraps_at, baud
        counts = tick is not None and self._wraps_at is None
        self._count_clock = PacketCountClock(tick) if tick is not None and counts else None
        self._clock = None if tick is None or counts else DeviceClock(tick, self._wraps_at)
        self._bytes = self._readings = 0
        self._frame_size = MAX_FRAME_SIZE
        self._held: list[tuple[WheelReading, float]] = []  # readings before the clock has settled, stamps by then
        self._settled = False

    def counters(self) -> dict[str, int]:
        """Return the number of lost readings and the events of the clock."""
        clock = self._count_clock.clock if self._count_clock else self._clock
        lost = self._count_clock.lost if self._count_clock else 0
        return {"lost": lost} | ({"clock_jumps": clock.jumps, "clock_strays": clock.strays} if clock else {})

    def add(self, readings: Sequence[WheelReading], size: int, arrived: float) -> list[tuple[WheelReading, float]]:
        """Return readings with their stamps, seconds on the host's steady clock.

        readings  completed by the bytes that arrived together
        size      number of these bytes
        arrived   seconds

        In the first SETTLING_SECONDS of a base with a clock these are none, and then all of its readings.
        """
        before = self._bytes
        self._bytes += size
        self._readings += len(readings)
        if not readings:
            return []
        if before:
            self._frame_size = min(self._frame_size, max(1, round(self._bytes / self._readings)))
        clock = self._count_clock or self._clock
        if clock is None:
            return [(reading, arrived) for reading in readings]
        # The last one was delayed least; the others are computed from it.
        last = clock.stamp(int(readings[-1].time or 0), arrived)
        self._held += zip(readings, (last - self._ages(readings)).tolist(), strict=True)
        if not self._settled:
            ages = self._ages([reading for reading, _ in self._held])
            if ages[0] < SETTLING_SECONDS:
                return []
            self._settled = True
            self._restamp(last - ages)
        sending = (self._frame_size if self._frame_size < MAX_FRAME_SIZE else 0) * 10.0 / self._baud
        ready, self._held = [(reading, stamp - sending) for reading, stamp in self._held], []
        return ready

    def _ages(self, readings: Sequence[WheelReading]) -> Floats:
        """Return by how many seconds readings (n,) are older than the last of them."""
        clock = self._count_clock.clock if self._count_clock else self._clock
        assert clock is not None
        steps = [int(after.time or 0) - int(before.time or 0) for before, after in pairwise(readings)]
        if self._wraps_at is not None:
            steps = [step % self._wraps_at for step in steps]
        ages = np.append(np.cumsum(steps[::-1])[::-1], 0)
        return np.asarray(ages * clock.tick * (1.0 + clock.drift))

    def _restamp(self, settled: Floats) -> None:
        """Replace the stamps of the held readings by those of the settled clock (n,), if these can be right.

        Delays only make stamps late, and by limited times. If the device's clock restarted meanwhile, or readings were
        lost, the settled clock is not that of the first readings.
        """
        late = np.array([stamp for _, stamp in self._held]) - settled
        if np.all((late > -MIN_SPACING) & (late < MAX_DELAY)):
            self._held = [(reading, stamp) for (reading, _), stamp in zip(self._held, settled.tolist(), strict=True)]
