"""Estimate the scale of a gyroscope's rates, to find rates in degrees per second and axes that point down.

Over intervals of SPAN, the turn x that the rates add up to is compared with the turn y of the lidar from scan matching,

    x = g y + b T,

with the scale g, the bias b of the rates, and the duration T. Weights lower the influence of wrong matches. The
standard deviation is that of the jackknife over the intervals. Some drivers publish degrees per second, or axes as they
are on the board.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..messages import Floats, Message, YawRate
from .student import upper_limit
from .turns import Run, Turns

# Seconds of an interval at least. Origin: chosen, as for delays; turns exceed the error of matching.
SPAN = 1.0
# Seconds between rates at most, to add them up. Origin: chosen, as for a gyroscope that is silent; not measured.
MAX_PERIOD = 0.2
# Intervals for an estimate at least. Origin: chosen; a jackknife of fewer says little about the standard deviation.
MIN_INTERVALS = 8
# Factor by which the scale differs from that of a unit at most, or its inverse.
# Origin: chosen, well beyond calibration errors, and far below the ratio of the units.
MAX_FACTOR = 2.0
# Typical errors of an interval from which on its weight falls. Origin: chosen, usual for robust weights.
ROBUST_SIGMAS = 3.0
# Times that the weights are computed. Origin: numerical.
WEIGHT_ITERATIONS = 10
# Radians, least typical error of an interval. Origin: numerical.
MIN_ERROR = 1e-5
# Scales of the units that are known, by their names. Origin: definition.
UNITS = {"radians per second": 1.0, "degrees per second": 180.0 / np.pi}
# Probability of a wrong decision. Origin: chosen, so that no user meets it.
ERROR_PROBABILITY = 1e-6


@dataclass(frozen=True)
class GyroscopeScale:
    """Rates of a gyroscope per radian per second that the lidar turns counter-clockwise.

    found      scale as found
    sigma      its standard deviation
    intervals  over which turns were compared
    """

    found: float
    sigma: float
    intervals: int

    @cached_property
    def used(self) -> float | None:
        """Scale of the unit and direction that the rates are in; None if they do not measure the turns of the lidar.

        It is 1, radians per second counter-clockwise, unless that is certainly wrong.
        """
        reach = self.sigma * upper_limit(ERROR_PROBABILITY, self.intervals - 1)
        if self.found - reach < MAX_FACTOR and self.found + reach > 1.0 / MAX_FACTOR:
            return 1.0
        scales = [direction * unit for unit in UNITS.values() for direction in (1.0, -1.0)]
        return next((one for one in scales if 1.0 / MAX_FACTOR < self.found / one < MAX_FACTOR), None)

    def interpretations(self) -> list[str]:
        """Return how the rates are read if they are converted, as lines of text."""
        if self.used is None or self.used == 1.0:
            return []
        unit = next(name for name, scale in UNITS.items() if scale == abs(self.used))
        return [f"gyroscope in {unit}{' clockwise' * (self.used < 0.0)}, {self._evidence()}; converted"]

    def doubts(self) -> list[str]:
        """Return what is probably wrong with the rates, as lines of text."""
        if self.used is None:
            return [f"the gyroscope does not measure the turns of the lidar, {self._evidence()}: it is ignored"]
        if self.used < 0.0:
            return [
                "gyroscope and lidar turn in opposite directions, so one of them is upside down; if it is the lidar, "
                "the map is a mirror image"
            ]
        return []

    def converted(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield messages with the rates in radians per second counter-clockwise, without those that are of no use."""
        for message in messages:
            if not isinstance(message, YawRate) or self.used == 1.0:
                yield message
            elif self.used is not None:
                yield YawRate(message.stamp, message.rate / self.used)

    def _evidence(self) -> str:
        return f"{self.found:.3g} ± {self.sigma:.2g} times the turns that the scans show"


def estimate_gyroscope_scale(turns: Turns) -> GyroscopeScale | None:
    """Return the scale over the turns of a drive; None if the data do not determine it."""
    rows = np.array([row for run in turns.runs for row in _intervals(run, turns.rates)])
    if len(rows) < MIN_INTERVALS:
        return None
    weights = np.ones(len(rows))
    try:
        for _ in range(WEIGHT_ITERATIONS):
            normal, right = _normal_equations(rows, weights)
            found, bias = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
            errors = np.abs(rows[:, 2] - found * rows[:, 0] - bias * rows[:, 1])
            weights = 1.0 / (1.0 + (errors / (ROBUST_SIGMAS * max(float(np.median(errors)), MIN_ERROR))) ** 2)
        normal, right = _normal_equations(rows, weights)
        without_one = np.linalg.solve(normal.sum(axis=0) - normal, (right.sum(axis=0) - right)[:, :, None])[:, 0, 0]
    except np.linalg.LinAlgError:  # nothing turned
        return None
    count = len(rows)
    sigma = float(np.sqrt((count - 1) / count * ((without_one - found) ** 2).sum()))
    return GyroscopeScale(float(found), sigma, count) if np.isfinite([found, sigma]).all() else None


def _normal_equations(rows: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return matrices (n, 2, 2) and right sides (n, 2) for scale and bias, of intervals (n, 3) with weights (n,)."""
    inputs = rows[:, :2]
    return weights[:, None, None] * inputs[:, :, None] * inputs[:, None, :], (weights * rows[:, 2])[:, None] * inputs


def _intervals(run: Run, rates: Floats) -> list[tuple[float, float, float]]:
    """Return the turn of the lidar, the duration, and the turn by the rates (m, 2) of the intervals of a run."""
    stamps = rates[:, 0]
    angles = np.concatenate([[0.0], np.cumsum(0.5 * (rates[1:, 1] + rates[:-1, 1]) * np.diff(stamps))])[: len(rates)]
    intervals = []
    first = 0
    while (second := int(np.searchsorted(run.stamps, run.stamps[first] + SPAN))) < len(run.stamps):
        begin, end = run.stamps[first], run.stamps[second]
        low, high = np.searchsorted(stamps, [begin, end])
        around = stamps[max(0, low - 1) : high + 1]
        if len(around) > 1 and around[0] <= begin and around[-1] >= end and np.diff(around).max() < MAX_PERIOD:
            before, after = np.interp([begin, end], stamps, angles)
            turned = run.poses[second, 2] - run.poses[first, 2]
            intervals.append((float(turned), float(end - begin), float(after - before)))
        first = second
    return intervals
