"""Random errors of wheel odometry: variances per metre and per radian, from motions as measured and as registered."""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled
from features.normal_limits import GROSS_LIMIT

from ..geometry.angles import wrap_angle
from ..geometry.median import median
from ..geometry.normal_distribution import NORMAL_MEDIAN, NORMAL_MEDIAN_ERROR
from ..geometry.segments import Floats
from .heading_errors import is_turn
from .systematic_errors import PRIOR_SAMPLES

# Smallest variance of the random errors, square metres or square radians per metre: no wheels err by less than 0.1 mm
# or 0.1 mrad in a metre. Origin: numerical, far below real wheels.
MIN_VARIANCE_RATE = 1e-8
# Radians: drift of the heading by turning one radian, before any driving. Origin: measured, 0.02 to 0.12 on recordings
# of nine robots.
TURN_WALK = 0.04


def estimate_rates(
    initial: Floats, corrected: Floats, registered: Floats, variances: Floats, travel: Floats, floors: Floats
) -> Floats:
    """Return (4,) variances: along and across a motion per square metre, of heading per metre and per radian of turn.

    initial     (4,) before any driving; they count for PRIOR_SAMPLES motions in a geometric mean, as they may be wrong
                by a factor: in an arithmetic mean a value five times too large would dominate after a hundred motions
    corrected   (n, 3) motions as measured, without their systematic errors
    registered  (n, 3) the same motions as registered
    variances   (n, 2) of the registered motions: of the position in one direction, and of the heading
    travel      (n,) metres of wheel travel
    floors      (2,) standard deviations of a single reading, of position and heading
    """
    # contiguous: the function would be compiled again for columns of a larger array
    registered, variances = np.ascontiguousarray(registered), np.ascontiguousarray(variances)
    observed, counts = _observed_rates(corrected, registered, variances, travel, floors)
    weights = counts / (counts + PRIOR_SAMPLES)
    least = MIN_VARIANCE_RATE
    return np.asarray(np.maximum(initial, least) ** (1.0 - weights) * np.maximum(observed, least) ** weights)


@compiled
def _observed_rates(corrected, registered, variances, travel, floors):  # type: ignore[no-untyped-def]
    """Return the rates (4,) from the motions alone, and the numbers (4,) of motions that they are estimated from."""
    count = len(travel)
    along, across, heading = np.empty((2, count)), np.empty((2, count)), np.empty(count)
    straight, turns = np.empty((2, count)), np.empty((2, count))
    straight_count, turn_count = 0, 0
    for k in range(count):
        x, y = registered[k, 0] - corrected[k, 0], registered[k, 1] - corrected[k, 1]
        c, s = math.cos(corrected[k, 2]), math.sin(corrected[k, 2])
        noise, scale = variances[k, 0] + floors[0] ** 2, travel[k] ** 2
        along[0, k], along[1, k] = (c * x + s * y) ** 2 / (NORMAL_MEDIAN * scale), noise / scale
        across[0, k], across[1, k] = (c * y - s * x) ** 2 / (NORMAL_MEDIAN * scale), noise / scale
        heading[k] = wrap_angle(registered[k, 2] - corrected[k, 2]) ** 2 / NORMAL_MEDIAN
        if not is_turn(corrected[k, 2], registered[k, 2]):
            noise = variances[k, 1] + floors[1] ** 2
            straight[0, straight_count], straight[1, straight_count] = heading[k] / travel[k], noise / travel[k]
            straight_count += 1
    rates = np.zeros(4)
    counts = np.array([count, count, straight_count, count - straight_count], dtype=np.float64)
    rates[0], rates[1] = _median_excess(along), _median_excess(across)
    rates[2] = _median_excess(straight[:, :straight_count].copy())
    for k in range(count):
        if is_turn(corrected[k, 2], registered[k, 2]):
            turn = abs(corrected[k, 2])
            noise = variances[k, 1] + floors[1] ** 2 + rates[2] * travel[k]
            turns[0, turn_count], turns[1, turn_count] = heading[k] / turn, noise / turn
            turn_count += 1
    # The noise subtracted from turns contains the drift by driving and may be most of the median, which is then small:
    # what a few gross errors add to it counts.
    rates[3] = _median_excess(_without_gross_errors(turns[:, :turn_count].copy()))
    return rates, counts


@compiled
def _without_gross_errors(values):  # type: ignore[no-untyped-def]
    """Return the columns of `values` (2, n), squared errors and their known noise, without the gross errors."""
    if not values.shape[1]:
        return values
    return values[:, NORMAL_MEDIAN * values[0] <= GROSS_LIMIT**2 * median(values[0])]


@compiled
def _median_excess(values):  # type: ignore[no-untyped-def]
    """Return the median of squared errors without the noise that is known, values (2, n): the squares, the noise.

    It is at least the standard error of the squares' median: less cannot be told from the noise.
    """
    count = values.shape[1]
    if not count:
        return 0.0
    return max(median(values[0] - values[1]), NORMAL_MEDIAN_ERROR / math.sqrt(count) * median(values[0]))
