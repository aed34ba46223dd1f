"""Mapping of a device's clock to the host's clock.

Bytes reach the host late, by transmission and by delays of the host, but never early. So the true relation of the two
clocks,

    host = offset + rate * device,

is a line below all pairs of device time and arrival, and touches the undelayed pairs. Of all lines below the pairs of
the last WINDOW seconds the one with the smallest sum of vertical distances is fitted: the maximum-likelihood line for
exponentially distributed delays, on which delayed pairs have no influence, however many. This line is the edge of the
pairs' lower convex hull above their mean device time, unless its rate differs from one by more than MAX_DRIFT.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..messages import Floats

WINDOW = 30.0
"""Seconds of device time that are fitted. Long enough to contain undelayed pairs and for a precise rate; not longer,
because the drift of a quartz depends on temperature."""
BIN = 0.25
"""Seconds of device time of which only the least delayed pair is stored: at most WINDOW / BIN pairs in total."""
MAX_DRIFT = 0.01
"""Deviation of the rate from one. Ceramic resonators, used on small boards, are within 0.5 %, a quartz 0.01 %."""
MIN_RATE_SPAN = 1.0
"""Seconds of device time below which a fit keeps the previous rate: delays of milliseconds mask any drift."""
MAX_EARLINESS = 0.010
"""Seconds that a pair may lie below the line; more indicates a jump of the device's clock."""
SETTLING_SPAN = 5.0
"""Seconds of device time below which an earlier pair is no jump: then all pairs before it were delayed, such as bytes
that were buffered until the port was opened."""
MAX_DELAY = 2.0
"""Seconds that a pair may lie above the line. Serial buffers hold about one second of any device; more is a jump."""
CONFIRMATIONS = 5
"""Consecutive pairs off the line that confirm a jump; fewer are single wrong readings."""
MIN_STEP = 0.005
"""Seconds. If all pairs of STEP_DURATION seconds are later than this, the device's clock made a small step back, as a
clock that counts samples does if some are lost."""
STEP_DURATION = 2.0
"""Seconds on the host's clock; on a busy host there are undelayed pairs within tenths of a second."""

Pair = tuple[float, float]
"""(device time, arrival), seconds."""


class DeviceClock:
    """Converter of a device's time to the host's time.

    tick      nominal seconds per unit of the device's time
    wraps_at  units at which the device's time wraps to zero; None if it does not
    jumps     number of jumps of the device's clock: restarts, lost samples
    strays    number of readings that were off the line without a jump

    The smallest delay cannot be observed: all stamps are late by it. A caller that knows it (bytes / baud rate)
    subtracts it. A measurement n units after a stamped time has that stamp plus n * tick * (1 + drift).
    """

    def __init__(self, tick: float, wraps_at: int | None = None) -> None:
        self.tick, self.wraps_at = tick, wraps_at
        self.jumps = self.strays = 0
        self._rate = 1.0
        self._restart()

    @property
    def drift(self) -> float:
        """Relative drift: how much slower than nominal the device's clock runs; 1e-6 is one part per million."""
        return self._rate - 1.0

    def stamp(self, device_time: float, arrived: float) -> float:
        """Return the host's time (seconds) of a device time, never later than its arrival.

        device_time  units of `tick`, wrapped or not
        arrived      host's time of arrival, seconds

        Stamps increase with the device's time, except for corrections of the fit: as large as the delays in the first
        seconds, tenths of milliseconds later, and any size if the device's clock jumps.
        """
        pair = (self._unwrapped(device_time, arrived) * self.tick, arrived)
        late = self._late(pair)
        if self._pairs and -MAX_DELAY < late < -MAX_EARLINESS and self._span() < SETTLING_SPAN:
            self._restart()
        elif self._pairs and not -MAX_EARLINESS <= late <= MAX_DELAY:
            return self._off_the_line(pair)
        self.strays += len(self._held)
        self._held.clear()
        self._add(pair, late)
        if self._stepped(late, arrived):
            self._jump([pair])
        return min(self._host(pair[0]), arrived)

    @property
    def stored_pairs(self) -> int:
        """Number of pairs in memory, including unconfirmed ones."""
        return len(self._pairs) + len(self._held)

    def register_jump(self) -> None:
        """Restart the fit after a jump of the clock; the rate is kept."""
        self.jumps += 1
        self._restart()

    def host_times(self, device_times: NDArray[Any]) -> Floats:
        """Return the host's times (n,) of device times (n,), units of `tick` without wraps, by the line fitted now."""
        return np.asarray(self._anchor[1] + self._rate * (device_times * self.tick - self._anchor[0]))

    def _host(self, device: float) -> float:
        return self._anchor[1] + self._rate * (device - self._anchor[0])

    def _late(self, pair: Pair) -> float:
        return pair[1] - self._host(pair[0])

    def _span(self) -> float:
        return self._pairs[-1][0] - self._pairs[0][0]

    def _unwrapped(self, device_time: float, arrived: float) -> float:
        """Return the device time without wraps that is nearest to the one expected from the arrival."""
        if self.wraps_at is None or not self._pairs:
            return device_time
        expected = (self._anchor[0] + (arrived - self._anchor[1]) / self._rate) / self.tick
        return device_time + self.wraps_at * round((expected - device_time) / self.wraps_at)

    def _restart(self) -> None:
        self._pairs: deque[Pair] = deque(maxlen=round(WINDOW / BIN))  # least delayed of each bin, oldest first
        self._held: list[Pair] = []  # off the line, not confirmed as a jump yet
        self._anchor: Pair = (0.0, 0.0)  # point on the line
        self._late_since: float | None = None

    def _off_the_line(self, pair: Pair) -> float:
        """Return the stamp of a pair that may be the first after a jump: its arrival, until the jump is confirmed."""
        self._held.append(pair)
        if len(self._held) == CONFIRMATIONS:
            self._jump(self._held)
            return min(self._host(pair[0]), pair[1])
        return pair[1]

    def _jump(self, pairs: list[Pair]) -> None:
        """Restart the fit with these pairs; the rate is kept."""
        self.register_jump()
        for pair in pairs:
            self._add(pair, self._late(pair))

    def _stepped(self, late: float, arrived: float) -> bool:
        """Return true if all pairs of the last STEP_DURATION seconds were late by more than MIN_STEP."""
        if late < MIN_STEP:
            self._late_since = None
        elif self._late_since is None:
            self._late_since = arrived
        return self._late_since is not None and arrived - self._late_since > STEP_DURATION

    def _add(self, pair: Pair, late: float) -> None:
        if not self._pairs:
            self._pairs.append(pair)
            self._anchor = pair
            return
        is_new_bin = pair[0] // BIN != self._pairs[-1][0] // BIN
        if is_new_bin:
            self._pairs.append(pair)
        elif late < self._late(self._pairs[-1]):
            self._pairs[-1] = pair
        if is_new_bin or late < 0.0:
            self._fit()

    def _fit(self) -> None:
        """Fit the line below the stored pairs."""
        pairs = sorted(self._pairs)
        if self._span() >= MIN_RATE_SPAN:
            self._rate = min(max(_rate_below(pairs), 1.0 - MAX_DRIFT), 1.0 + MAX_DRIFT)
        self._anchor = min(pairs, key=lambda pair: pair[1] - self._rate * pair[0])


def _rate_below(pairs: list[Pair]) -> float:
    """Return the slope of the lower convex hull's edge at the mean device time of the pairs, which are sorted."""
    middle = sum(device for device, _ in pairs) / len(pairs)
    hull: list[Pair] = []
    for pair in pairs:
        if hull and hull[-1][0] == pair[0]:
            continue
        while len(hull) > 1 and _slope(hull[-2], hull[-1]) >= _slope(hull[-1], pair):
            hull.pop()
        hull.append(pair)
    return next(_slope(start, end) for start, end in pairwise(hull) if end[0] >= middle)


def _slope(start: Pair, end: Pair) -> float:
    return (end[1] - start[1]) / (end[0] - start[0])
