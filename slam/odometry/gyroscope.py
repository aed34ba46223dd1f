"""Turns measured by a gyroscope, whose bias is estimated by comparing them with registration."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from drivers import se2
from drivers.messages import Odometry, YawRate
from features.normal_limits import NORMAL_LIMIT

from .arc import with_turn
from .measurement_clock import MAX_PERIOD

# Radians per second: standard deviation of the bias before any driving. Origin: data sheets of inexpensive gyroscopes,
# 1 degree per second.
INITIAL_BIAS_SIGMA = math.radians(1.0)
# Radians per second after one second: random walk of the bias. Origin: data sheets of inexpensive gyroscopes, 10
# degrees per hour within a minute, and warming up.
BIAS_WALK = math.radians(10.0) / 3600.0
# Relative standard deviation of the scale. Origin: data sheets of inexpensive gyroscopes, 1 %.
SCALE_SIGMA = 0.01
# Seconds over which turns are compared: the longer, the less the headings at both ends matter. Origin: chosen; not
# measured.
COMPARISON_INTERVAL = 2.0
# Seconds of rates that are kept. Origin: chosen, longer than scans wait for odometry; not measured.
MEMORY = 30.0


class Gyroscope:
    """Turns between two stamps, and the bias of the rates, estimated by a Kalman filter.

    bias   radians per second
    sigma  its standard deviation
    """

    def __init__(self) -> None:
        self.bias, self._variance = 0.0, INITIAL_BIAS_SIGMA**2
        self._rates: deque[tuple[float, float, float]] = deque()  # stamp, rate, angle up to the stamp
        self._since: float | None = None  # begin of the turn that is compared
        self._registered = 0.0  # turn since then

    @property
    def present(self) -> bool:
        """True if there were readings."""
        return bool(self._rates)

    @property
    def sigma(self) -> float:
        """Standard deviation of the bias, radians per second."""
        return math.sqrt(self._variance)

    def add(self, reading: YawRate) -> None:
        """Add a reading; one that is not later than the last is ignored."""
        angle = 0.0
        if self._rates:
            stamp, rate, before = self._rates[-1]
            if reading.stamp <= stamp:
                return
            angle = before + 0.5 * (rate + reading.rate) * (reading.stamp - stamp)
            if reading.stamp - stamp > MAX_PERIOD:
                self._rates.clear()
        self._rates.append((reading.stamp, reading.rate, angle))
        while self._rates[0][0] < reading.stamp - MEMORY:
            self._rates.popleft()

    def turn(self, since: float, until: float) -> float | None:
        """Return the radians turned between two stamps, without the bias; None if rates are missing."""
        first, last = self._angle(since), self._angle(until)
        return None if first is None or last is None else last - first - self.bias * (until - since)

    def correct(self, stamp: float, turn: float | None, variance: float, turned: float = 0.0) -> None:
        """Correct the bias by the turn of the path between the last scan and one at `stamp`.

        turn      radians; None if it is not known
        variance  of the heading of a scan
        turned    radians by which the map then turned the pose of the later scan. What registrations sum up from one
                  keyframe to the next is an error of the turn; if it is larger than their errors, as after a loop
                  closure, the path until then was turned as well
        """
        if turn is None or self._since is None:
            self._since, self._registered = stamp, 0.0
            return
        if turned**2 > NORMAL_LIMIT**2 * 2.0 * variance:
            self._since = None
            return
        self._registered += turn + turned
        interval = stamp - self._since
        if interval < COMPARISON_INTERVAL:
            return
        measured = self.turn(self._since, stamp)
        if measured is not None:
            self._compare(measured, interval, variance)
        self._since, self._registered = stamp, 0.0

    def _compare(self, measured: float, interval: float, variance: float) -> None:
        """Update the bias by a turn that was measured, and as it was registered."""
        noise = (2.0 * variance + (SCALE_SIGMA * measured) ** 2) / interval**2  # of the headings at both ends
        predicted = min(self._variance + BIAS_WALK**2 * interval, INITIAL_BIAS_SIGMA**2)
        error = (measured - self._registered) / interval
        self._variance = predicted
        if error**2 <= NORMAL_LIMIT**2 * (predicted + noise):  # else a scan was placed wrongly, or the map was turned
            gain = predicted / (predicted + noise)
            self.bias += gain * error
            self._variance = (1.0 - gain) * predicted

    def _angle(self, stamp: float) -> float | None:
        """Return the angle at a stamp, linear between rates; None if there are none near it."""
        rates = self._rates
        if not rates or not rates[0][0] <= stamp <= rates[-1][0] + MAX_PERIOD:
            return None
        k = len(rates) - 1
        while rates[k][0] > stamp:
            k -= 1
        before, rate, angle = rates[k]
        return angle + rate * (stamp - before)


class GyroscopeOdometry:
    """Odometry with the turns of a gyroscope instead of those of the wheels; theirs where the gyroscope is silent."""

    def __init__(self, gyroscope: Gyroscope) -> None:
        self._gyroscope = gyroscope
        self._last: Odometry | None = None  # of the wheels
        self._pose = np.zeros(3)

    def combined(self, reading: Odometry) -> Odometry:
        """Return a reading of the wheels with the heading of the gyroscope: an arc of the same length."""
        last, self._last = self._last, reading
        if last is None or not self._gyroscope.present:
            self._pose = reading.pose
            return reading
        motion = se2.between(last.pose, reading.pose)
        turn = self._gyroscope.turn(last.stamp, reading.stamp)
        if turn is not None:
            motion = with_turn(motion, turn)
        self._pose = se2.compose(self._pose, motion)
        return Odometry(reading.stamp, self._pose)
