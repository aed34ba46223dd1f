"""A device's clock fitted to the host's.

Bytes reach the host late, by the time on the wire and by whatever kept the host busy, but never early. So the true
relation of the two clocks,

    host = offset + rate * device,

lies below all pairs of device time and arrival, and touches those that nothing held up. Of all lines below the pairs
of the last WINDOW seconds the fit takes the one with the smallest sum of distances to them: for delays that are
exponentially distributed it is the line of maximum likelihood, and one late pair or a thousand do not move it. This
line is an edge of the pairs' lower convex hull, the one above their mean device time, unless its rate is further
than LARGEST_DRIFT from one.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

WINDOW = 30.0
"""Seconds of device time that are remembered. Long, to find undelayed pairs and a precise rate; short, because the
drift of a quartz follows the temperature."""
SPAN = 0.25
"""Seconds of device time of which only the earliest pair is kept, which bounds the memory to WINDOW / SPAN pairs."""
LARGEST_DRIFT = 0.01
"""Ceramic resonators, as small boards have them, are within 0.5 %; a quartz within 0.01 %."""
YOUNG = 1.0
"""Seconds of device time below which a fit keeps the rate it had: delays of milliseconds hide any drift so long."""
EARLY = 0.010
"""Seconds that a pair may lie below the line and still be of the same clock; more is a jump of the device's clock."""
SETTLED = 5.0
"""Seconds of device time below which an earlier pair is believed anyhow, and all before it was held up, as bytes are
that wait in a port until it is opened."""
LOSS_DELAY = 2.0
"""Seconds that a pair may be late. Serial buffers hold about one second of any device; more is a jump."""
CONFIRM = 5
"""Pairs in a row that are off the line before the clock is taken to have jumped; fewer are single wrong readings."""
STEP = 0.005
"""Seconds. Where all pairs of STEADY seconds are later than this, the device's clock stepped back by so little, as a
clock does that counts samples when some are lost."""
STEADY = 2.0
"""Seconds on the host's clock; busy hosts let single pairs pass in time within tenths of a second."""

Pair = tuple[float, float]
"""Device time and arrival, seconds."""


class DeviceClock:
    """Turns a device's time into the host's, pair by pair.

    tick      seconds of the host per unit of the device's time, nominally
    wraps_at  units after which the device's time begins again at zero; None where it does not
    jumps     how often the device's clock was found to have jumped: a restart, lost samples
    strays    readings that were off the line without a jump

    The smallest delay on the way cannot be seen from the host: stamps are later than the truth by it. A caller that
    knows it (bytes over baud rate) subtracts it. What was measured n units after a stamped time has its stamp plus
    n * tick * (1 + drift).
    """

    def __init__(self, tick: float, wraps_at: int | None = None) -> None:
        self.tick, self.wraps_at = tick, wraps_at
        self.jumps = self.strays = 0
        self._rate = 1.0
        self._restart()

    @property
    def drift(self) -> float:
        """How much slower than nominal the device's clock runs, as a ratio to the host's: 1e-6 is one in a million."""
        return self._rate - 1.0

    def stamp(self, device_time: float, arrived: float) -> float:
        """The host's time (seconds) at the device's time (units of `tick`, wrapped or not), of which the host knew
        at `arrived` (seconds). Never later than `arrived`.

        Stamps grow with the device's time, except that they move by the corrections of the fit: within the first
        seconds by the delays, later by tenths of milliseconds, and anyhow where the device's clock jumped.
        """
        pair = (self._unwrapped(device_time, arrived) * self.tick, arrived)
        late = self._late(pair)
        if self._pairs and -LOSS_DELAY < late < -EARLY and self._span() < SETTLED:
            self._restart()
        elif self._pairs and not -EARLY <= late <= LOSS_DELAY:
            return self._off_the_line(pair)
        self.strays += len(self._held)
        self._held.clear()
        self._add(pair, late)
        if self._stepped(late, arrived):
            self._jump([pair])
        return min(self._host(pair[0]), arrived)

    def jumped(self) -> None:
        """Begin again, because the clock is known to have jumped; the rate remains."""
        self.jumps += 1
        self._restart()

    def _host(self, device: float) -> float:
        return self._anchor[1] + self._rate * (device - self._anchor[0])

    def _late(self, pair: Pair) -> float:
        return pair[1] - self._host(pair[0])

    def _span(self) -> float:
        return self._pairs[-1][0] - self._pairs[0][0]

    def _unwrapped(self, device_time: float, arrived: float) -> float:
        """The device time of this remainder that is nearest to what the arrival lets expect."""
        if self.wraps_at is None or not self._pairs:
            return device_time
        expected = (self._anchor[0] + (arrived - self._anchor[1]) / self._rate) / self.tick
        return device_time + self.wraps_at * round((expected - device_time) / self.wraps_at)

    def _restart(self) -> None:
        self._pairs: deque[Pair] = deque(maxlen=round(WINDOW / SPAN))  # the earliest of each span, oldest first
        self._held: list[Pair] = []  # off the line, not yet confirmed
        self._anchor: Pair = (0.0, 0.0)  # a point of the line
        self._late_since: float | None = None

    def _off_the_line(self, pair: Pair) -> float:
        """Stamp a pair that may be the first after a jump: nothing but its arrival says when it was."""
        self._held.append(pair)
        if len(self._held) == CONFIRM:
            self._jump(self._held)
            return min(self._host(pair[0]), pair[1])
        return pair[1]

    def _jump(self, pairs: list[Pair]) -> None:
        """Begin again with these pairs; the rate remains."""
        self.jumped()
        for pair in pairs:
            self._add(pair, self._late(pair))

    def _stepped(self, late: float, arrived: float) -> bool:
        if late < STEP:
            self._late_since = None
        elif self._late_since is None:
            self._late_since = arrived
        return self._late_since is not None and arrived - self._late_since > STEADY

    def _add(self, pair: Pair, late: float) -> None:
        if not self._pairs:
            self._pairs.append(pair)
            self._anchor = pair
            return
        begins = pair[0] // SPAN != self._pairs[-1][0] // SPAN
        if begins:
            self._pairs.append(pair)
        elif late < self._late(self._pairs[-1]):
            self._pairs[-1] = pair
        if begins or late < 0.0:
            self._fit()

    def _fit(self) -> None:
        """Lay the line under the pairs anew."""
        pairs = sorted(self._pairs)
        if self._span() >= YOUNG:
            self._rate = min(max(_rate_below(pairs), 1.0 - LARGEST_DRIFT), 1.0 + LARGEST_DRIFT)
        self._anchor = min(pairs, key=lambda pair: pair[1] - self._rate * pair[0])


def _rate_below(pairs: list[Pair]) -> float:
    """The slope of the lower convex hull's edge above the mean of the pairs' device times; pairs sorted."""
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
