"""Velocity of a rolling platform, estimated from the poses of its scans."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from .arc import with_turn

# Metres per second squared, twice, and radians per second squared: standard deviations of the acceleration of a rolling
# platform, which is as large to the side as ahead if the lidar is not on the axle.
# Origin: chosen, indoor robots accelerate by up to 1 m/s^2 and start to turn within half a second; not measured.
ACCELERATIONS = np.array([1.0, 1.0, 3.0])
# Velocities that no indoor robot exceeds, as standard deviations: the uncertainty does not grow beyond them.
# Origin: chosen, metres and radians per second.
MAX_VELOCITIES = np.array([1.0, 1.0, 2.0])
MAX_VARIANCES = MAX_VELOCITIES**2  # Origin: definition.
# Seconds for which a robot moves evenly: after that time it may have any velocity.
# Origin: definition, the time in which ACCELERATIONS lead to MAX_VELOCITIES.
STEADY_SECONDS = float((MAX_VELOCITIES / ACCELERATIONS).min())
# Latest intervals between scans of which the median is the lidar's period, or the mean if they come in bursts.
# Origin: chosen, longer than the bursts of a computer that is busy for some seconds; not measured.
PERIOD_SAMPLES = 101
# Seconds. Smallest period of a lidar: in a shorter time the stamps of a burst follow each other.
# Origin: definition, the fastest two-dimensional lidars measure 100 scans per second; half of their period.
MIN_PERIOD = 0.005
# Share of the period below which the interval between two stamps shows that they come in bursts. Not half: a log
# without some of its scans has intervals of one, two and three periods. Origin: chosen; not measured.
MIN_INTERVAL = 0.25


class VelocityFilter:
    """Velocity [x, y, heading] in the base's frame, a Kalman filter for each component.

    Process noise is the acceleration of the platform, and a measurement the motion between two scans divided by their
    interval. Where the scans do not determine the motion, its variance is large, so that the velocity stays as it was.

    velocity   (3,) metres and radians per second
    variances  (3,)
    """

    def __init__(self, velocity: Floats | None = None, variances: Floats | None = None) -> None:
        self.velocity = np.zeros(3) if velocity is None else velocity
        self.variances = MAX_VARIANCES if variances is None else variances

    def motion(self, seconds: float) -> se2.Pose:
        """Return the motion [x, y, heading] within some seconds, along an arc."""
        arc = self.velocity * seconds
        turn, arc[2] = float(arc[2]), 0.0
        return with_turn(arc, turn)

    def deviations(self, seconds: float) -> Floats:
        """Return (3,) the standard deviations of a motion within some seconds, metres and radians."""
        return np.asarray(np.sqrt(self._predicted_variances(seconds)) * seconds)

    def correct(self, motion: se2.Pose | None, covariance: Floats, seconds: float) -> None:
        """Correct the velocity by the motion within some seconds; None if it is not known.

        `covariance` (3, 3) is that of the pose at its end.
        """
        self.variances = self._predicted_variances(seconds)
        if motion is not None:
            noise = 2.0 * covariance.diagonal() / seconds**2  # of the poses at both ends
            gain = self.variances / (self.variances + noise)
            arc = with_turn(motion, 0.0)
            arc[2] = motion[2]
            self.velocity = self.velocity + gain * (arc / seconds - self.velocity)
            self.variances = (1.0 - gain) * self.variances

    def _predicted_variances(self, seconds: float) -> Floats:
        return np.asarray(np.minimum(self.variances + (ACCELERATIONS * seconds) ** 2, MAX_VARIANCES))


class ScanClock:
    """Seconds from scan to scan.

    The stamps of recordings may come in bursts, if a busy computer stamped the scans when it read them. The lidar
    turned evenly meanwhile, so the mean of the latest intervals is used then. If most scans are in bursts, the median
    is no period of a lidar either.

    last  stamp of the last scan; None before the first, and after `start_again`
    """

    def __init__(self, last: float | None = None, intervals: Sequence[float] = ()) -> None:
        self.last, self._latest, self._ordered = last, deque(intervals), sorted(intervals)

    @property
    def intervals(self) -> tuple[float, ...]:
        """Latest differences of stamps."""
        return tuple(self._latest)

    @property
    def period(self) -> float:
        """Period of the lidar in seconds; there must have been two scans."""
        return sum(self._ordered) / len(self._ordered) if self._in_bursts else self._median

    def start_again(self) -> None:
        """Measure no interval to the next scan: it may be one of the scans so far, or follow a break."""
        self.last = None

    def interval(self, stamp: float) -> float:
        """Return the seconds from the last scan to one at `stamp`, which becomes the last.

        The result is 0 for the first scan, and for the first one after `start_again`.
        """
        last, self.last = self.last, stamp
        if last is None:
            return 0.0
        self._add(stamp - last)
        return self.period if self._in_bursts else max(stamp - last, self.period)

    @property
    def _median(self) -> float:
        ordered = self._ordered
        return 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])

    @property
    def _in_bursts(self) -> bool:
        median = self._median
        return median < MIN_PERIOD or self._ordered[0] < MIN_INTERVAL * median

    def _add(self, interval: float) -> None:
        """Add an interval to the latest ones, which are kept in order too: to sort them for each scan takes longer."""
        self._latest.append(interval)
        insort(self._ordered, interval)
        if len(self._latest) > PERIOD_SAMPLES:
            del self._ordered[bisect_left(self._ordered, self._latest.popleft())]
