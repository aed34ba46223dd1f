"""Estimate the delay of the lidar's stamps against the odometry's.

The lidar's heading L(t) from scan matching is compared with that of odometry, H(t), by the turns over SPAN seconds,
y(t) = L(t) - L(t - SPAN) and x(t) likewise. With a delay d of the lidar's stamps and a scale g of odometry's turns,

    minimise over d and g:    sum_t w_t (y(t) - g x(t - d))^2.

Both headings are smoothed alike before: interpolation between readings averages their noise, most in the middle between
two, and the estimate would be drawn there. Weights w_t lower the influence of blocks in which a wheel slipped. The
standard deviation is that of the jackknife over blocks of one second, which includes all errors that change with time,
and of the grid's step.

If this leaves the delay uncertain, it is the one at which odometry explains all scans best (`pooled_delay.py`). Their
cost can have several minima, of which the jackknife sees but one. So the standard deviation is that of the bootstrap:
of the minima for samples of the blocks, drawn with replacement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..immutable import immutable
from ..messages import Floats
from .beam_times import STATED, BeamTimes
from .pooled_delay import delay_costs
from .robust_weights import MIN_ERROR, WEIGHT_ITERATIONS, robust_weights
from .student import CONTRADICTION_PROBABILITY, ERROR_PROBABILITY, MIN_VALUES, statistic, upper_limit
from .turns import MAX_SCAN_PERIOD, MIN_SCAN_PERIOD, Run, Turns, deskewed

# Seconds, step of the time grid and of the delays that are tried; the minimum is interpolated.
# Origin: numerical, a tenth of usual periods.
STEP = 0.02
# Seconds, largest delay that is found. Origin: chosen, twice the largest one met in recordings.
MAX_DELAY = 1.0
# Seconds over which turns are compared. Origin: measured, shorter and longer ones (0.5 to 4 s) have larger standard
# deviations in most of 36 recordings and simulations.
SPAN = 1.0
# Seconds of a block. Origin: geometry, errors of turns over SPAN that are farther apart have no reading in common.
BLOCK = SPAN
# Seconds. Largest standard deviation of a delay that the data determine. Origin: chosen; those of recordings are 0.006
# to 0.02, and those of the noise of robots that stand 0.2 to 3.
MAX_SIGMA = 0.1
# Samples of the blocks from which the standard deviation of the delay by pairs is determined. Origin: numerical, it is
# certain to 5 %.
DRAWS = 200
# Factor between the motions of two sensors, or its inverse, beyond which they are not those of the same robot.
# Origin: chosen, well beyond calibration errors, and far below the ratio of units.
MAX_SCALE = 2.0


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of the lidar against odometry.

    seconds    by which scans are stamped late (mid-sweep), negative if odometry is
    sigma      its standard deviation, seconds
    objection  why it should not be compensated, as text; None if it should be
    """

    seconds: float
    sigma: float
    objection: str | None


@immutable
class _Estimate:
    """Delay and its standard deviation (seconds), and the number of blocks of the drive that show it."""

    seconds: float
    sigma: float
    blocks: int

    def would_show(self, seconds: float) -> bool:
        """Return true if a delay of so many seconds would be significant."""
        return abs(seconds) / self.sigma > upper_limit(ERROR_PROBABILITY / 2, self.blocks - 1)

    @property
    def objection(self) -> str | None:
        """Why the delay should not be compensated; None if it is significant."""
        significant = self.would_show(self.seconds)
        return None if significant else f"not significant (error probability above {ERROR_PROBABILITY:g})"


@immutable
class _Blocks:
    """Sums over each block, for each of the delays of the grid: of x^2 and x y (b, d), of y^2 and 1 (b,)."""

    xx: Floats
    xy: Floats
    yy: Floats
    count: Floats


def estimate_delay(turns: Turns, times: BeamTimes = STATED) -> Delay | None:
    """Return the delay over the turns of a drive; None if the data do not determine it.

    times  when the beams of the scans were measured

    It is estimated from the lidar's turns. If it should not be compensated by them, and they would not show a delay of
    the time from scan to scan, as where few scans can be matched, it is estimated from all pairs of scans together, and
    the more certain estimate is returned.
    """
    if len(turns.odometry) < 2:
        return None
    runs = [part for run in turns.runs for part in deskewed(run, times)]
    by_turns, found = _by_turns(runs, turns.odometry), None
    if by_turns is not None:
        objection = by_turns.objection
        if objection is None and _predicts_worse(runs, turns.odometry, by_turns.seconds):
            objection = "contradicted by the turns from scan to scan"
        found = Delay(by_turns.seconds, by_turns.sigma, objection)
        if objection is None or by_turns.would_show(max(turns.scan_period, MIN_SCAN_PERIOD)):
            return found
    by_pairs = _by_pairs(turns, times)
    if by_pairs is None or (found is not None and found.sigma <= by_pairs.sigma):
        return found
    return Delay(by_pairs.seconds, by_pairs.sigma, by_pairs.objection)


def _by_turns(runs: Sequence[Run], odometry: Floats) -> _Estimate | None:
    """Return the delay by the turns of the lidar; None if they do not determine it."""
    if not runs:
        return None
    spacing = float(np.median(np.concatenate([np.diff(run.stamps) for run in runs])))
    smoothing = _gaussian(max(spacing, float(np.median(np.diff(odometry[:, 0])))))
    blocks = _collect(runs, odometry, smoothing)
    if blocks is None or len(blocks.yy) < MIN_VALUES:
        return None
    weights = _weights(blocks)
    return _determined(*_jackknife(blocks, weights), len(weights))


def _by_pairs(turns: Turns, times: BeamTimes) -> _Estimate | None:
    """Return the delay by all pairs of scans together; None if they do not determine it."""
    delays, costs = delay_costs(turns, times, MAX_DELAY, BLOCK)
    if len(costs) < MIN_VALUES:
        return None
    total, step = costs.sum(axis=0), float(delays[1] - delays[0])
    if not 0 < int(np.argmin(total)) < len(delays) - 1:
        return None
    drawn = np.random.default_rng(0).multinomial(len(costs), np.full(len(costs), 1.0 / len(costs)), DRAWS)
    variance = float(np.var([_minimum(cost) for cost in drawn @ costs])) + 1.0 / 12.0  # in steps of the grid
    seconds = float(delays[0]) + step * _minimum(total)
    return _determined(seconds, step * math.sqrt(variance), len(costs))


def _determined(seconds: float, sigma: float, blocks: int) -> _Estimate | None:
    """Return an estimate; None if it is at the end of the delays that are tried, or too uncertain."""
    if not abs(seconds) < MAX_DELAY - STEP or not 0.0 < sigma <= MAX_SIGMA:
        return None
    return _Estimate(seconds, sigma, blocks)


def _minimum(cost: Floats) -> float:
    """Return where the costs (d,) on a grid are least, interpolated, in steps from the first one."""
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    before, at, after = cost[k - 1 : k + 2]
    curvature = before - 2.0 * at + after
    offset = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
    return k + float(np.clip(offset, -1.0, 1.0))


def _gaussian(sigma: float) -> Floats:
    """Return the weights (k,) of a Gaussian filter with standard deviation `sigma` (seconds) on the time grid."""
    reach = int(np.ceil(3.0 * sigma / STEP))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * STEP / sigma) ** 2)
    return np.asarray(weights / weights.sum())


def _collect(runs: Sequence[Run], odometry: Floats, smoothing: Floats) -> _Blocks | None:
    """Compare the turns of all runs with odometry (m, 2) at all delays; None if no run is long enough.

    Blocks are left out if odometry has a gap within the largest delay of them.
    """
    span, reach, margin = round(SPAN / STEP), round(MAX_DELAY / STEP), len(smoothing) // 2
    rows = []
    for run in runs:
        grid = np.arange(run.stamps[0], run.stamps[-1], STEP)
        inner = len(grid) - 2 * margin
        if inner <= span + 1:
            continue
        around = grid[0] + STEP * np.arange(-reach, len(grid) + reach)
        lidar = np.convolve(np.interp(grid, run.stamps, run.poses[:, 2]), smoothing, "valid")
        wheels = np.convolve(np.interp(around, odometry[:, 0], odometry[:, 1]), smoothing, "valid")
        y, turned = lidar[span:] - lidar[:-span], wheels[span:] - wheels[:-span]
        x = np.array([turned[reach - shift :][: len(y)] for shift in range(-reach, reach + 1)])
        edges = np.linspace(0, len(y), max(1, round(len(y) * STEP / BLOCK)) + 1).astype(np.int64)
        for a, b in pairwise(edges):
            if _has_gap(odometry[:, 0], around[a], around[b - 1 + span + 2 * (margin + reach)]):
                continue
            rows.append(((x[:, a:b] ** 2).sum(axis=1), x[:, a:b] @ y[a:b], float(y[a:b] @ y[a:b]), float(b - a)))
    if not rows:
        return None
    xx, xy, yy, count = zip(*rows, strict=True)
    return _Blocks(np.array(xx), np.array(xy), np.array(yy), np.array(count))


def _has_gap(stamps: Floats, first: float, last: float) -> bool:
    """Return true if odometry readings between two stamps are too far apart to be interpolated."""
    inside = stamps[max(0, int(np.searchsorted(stamps, first)) - 1) : int(np.searchsorted(stamps, last)) + 1]
    return len(inside) < 2 or float(np.diff(inside).max()) > MAX_SCAN_PERIOD


def _scale(xx: Floats, xy: Floats) -> Floats:
    """Return the best scale of odometry's turns at each delay."""
    return np.asarray(np.clip(xy / np.maximum(xx, 1e-12), 1.0 / MAX_SCALE, MAX_SCALE))


def _best(blocks: _Blocks, weights: Floats) -> tuple[float, int, float]:
    """Return the delay with the least squared error, its index in the grid, and the scale there."""
    xx, xy = weights @ blocks.xx, weights @ blocks.xy
    scale = _scale(xx, xy)
    cost = weights @ blocks.yy - 2.0 * scale * xy + scale**2 * xx
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    return STEP * _minimum(cost) - MAX_DELAY, k, float(scale[k])


def _weights(blocks: _Blocks) -> Floats:
    """Return a weight for each block, lower for those with a large error."""
    weights = np.ones(len(blocks.yy))
    for _ in range(WEIGHT_ITERATIONS):
        _, k, scale = _best(blocks, weights)
        squared = blocks.yy - 2.0 * scale * blocks.xy[:, k] + scale**2 * blocks.xx[:, k]
        weights = robust_weights(np.sqrt(np.maximum(squared, 0.0) / blocks.count))
    return weights


def _jackknife(blocks: _Blocks, weights: Floats) -> tuple[float, float]:
    """Return the delay and its standard deviation from leaving out one block after the other."""
    count = len(weights)
    without = np.array([_best(blocks, np.where(np.arange(count) == left_out, 0.0, weights))[0]
                        for left_out in range(count)])  # fmt: skip
    resolution = STEP**2 / 12.0  # variance of a uniform distribution over a step of the grid
    sigma = float(np.sqrt((count - 1) * without.var() + resolution))
    return _best(blocks, weights)[0], sigma


def _predicts_worse(runs: Sequence[Run], odometry: Floats, seconds: float) -> bool:
    """Return true if odometry at stamps earlier by `seconds` predicts the turns from scan to scan worse.

    It does if neither the typical error becomes smaller nor the log-likelihood larger, or if the log-likelihood is
    significantly less. The typical error alone does not decide: where the robot drives straight most of the time, it is
    that of scan matching, whatever the delay. This is the prediction that SLAM makes. Odometry that was recorded with
    each scan may belong to it whatever its stamp says; the turns from scan to scan then fit best without compensation.
    The log-likelihoods are those of Cauchy distributed errors, so that single scans with wrong stamps do not decide.
    """
    turned = np.concatenate([np.diff(run.poses[:, 2]) for run in runs])
    recorded, compensated = (
        turned - np.concatenate([np.diff(np.interp(run.stamps - shift, *odometry.T)) for run in runs])
        for shift in (0.0, seconds)
    )
    scale = float(np.median(np.abs(recorded))) + MIN_ERROR
    loss = np.log1p((compensated / scale) ** 2) - np.log1p((recorded / scale) ** 2)
    if float(np.median(np.abs(compensated))) >= scale and float(loss.sum()) >= 0.0:
        return True
    return statistic(loss) > upper_limit(CONTRADICTION_PROBABILITY, len(loss) - 1)
