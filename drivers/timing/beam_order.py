"""Decide from the scans when and in which order a lidar measured its beams.

Some drivers turn the beams of a message round, but not their times. De-skewing then bends the scans of a turning robot
twice as much as none would. Others state the time that the program waited for a scan, or nothing, although the lidar
measures one beam after the other. Scans that are bent in different ways do not fit onto each other, so pairs of scans
are matched several times: de-skewed with the stated times, with reversed times, with those of a lidar that turns once
from scan to scan, in either direction, and with none. The motion during the sweep is that of scan matching. The
difference of the log-likelihoods of two hypotheses, taken over the pairs, has a mean and a standard error; their ratio
is Vuong's statistic for the comparison of models (Econometrica 57, 1989), here with Student's distribution because the
pairs are few.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from .. import se2
from ..messages import Floats, Scan
from .beam_times import STATED, BeamTimes
from .scan_matching import match, middle_offset, scan_points, surface
from .student import CONTRADICTION_PROBABILITY, MIN_VALUES, statistic, upper_limit
from .turns import Run, Turns

# Pairs of scans after which a decision is tried, those first that are bent most differently. Origin: measured, 20 pairs
# decide in most recordings, and 40 do not in two of five of one robot; 80 take two seconds of computing.
LOOKS = 20, 40, 80
# Radians, least difference of bending within a pair. Origin: chosen, the usual noise of a bearing; not measured.
MIN_BENDING = 0.002
# Metres between the scans of a pair at most. Origin: chosen, they should show the same surfaces; not measured.
MAX_DISTANCE = 1.0
# Probability of a wrong order if both explain the scans equally well. Origin: chosen. They do so only where little
# depends on it: if one is true, the other explains the scans worse.
WRONG_ORDER_PROBABILITY = 1e-4
# Directions in which the bending of two scans is compared. Origin: numerical.
DIRECTIONS = 48
# Relative difference from which on the stated duration of a turn is not the time from scan to scan.
# Origin: chosen; a smaller one bends scans by less than the noise of a bearing.
DIFFERENT = 0.2
# Ratio of the stated duration of a turn and the time from scan to scan, or the inverse, from which on the stated times
# are doubtful. Origin: chosen; a driver may send some times during a turn what has been measured since the same time of
# the turn before, and a program may leave out some scans of a fast lidar.
DOUBTFUL_RATIO = 10.0


@dataclass(frozen=True, slots=True)
class BeamOrderTest:
    """Result of the comparison.

    times         times of the beams that explain the scans best; None if the scans do not show it with certainty
    pairs         number of pairs of scans
    statistic     log-likelihood of the times that explain the scans best minus that of the opposite order, or of the
                  stated times if all beams were measured at once, divided by its standard error
    stated_sweep  seconds from the first beam of a scan to the last, as stated; 0 if nothing is stated
    stated_turn   the same of a whole turn of the lidar
    scan_period   seconds from scan to scan
    """

    times: BeamTimes | None
    pairs: int
    statistic: float
    stated_sweep: float
    stated_turn: float = 0.0
    scan_period: float = 0.0

    def doubts(self) -> list[str]:
        """Return that the stated times do not fit the time from scan to scan, as lines of text, if they are used."""
        turn, period = self.stated_turn, self.scan_period
        if self.times is not None or turn <= 0.0 or period / DOUBTFUL_RATIO < turn < DOUBTFUL_RATIO * period:
            return []
        return [
            f"the beams of a scan are measured within {self.stated_sweep:.3g} s by their stated times, but scans are "
            f"{period:.3g} s apart, and they do not show what is right: if the lidar turns once from scan to scan, set "
            f"lidar.turn_period={period:.3g}, and lidar.beam_order=reversed if clockwise"
        ]


def decide_beam_order(turns: Turns) -> BeamOrderTest:
    """Compare the hypotheses over the turns of a drive.

    The one with the highest likelihood is true if that is significantly higher than for the opposite order, and the
    scans contradict the others.
    """
    hypotheses, costs = _hypotheses(turns), list[tuple[float, ...]]()
    longest = max(hypotheses, key=lambda times: times.turn or 0.0)
    pairs = sorted((pair for run in turns.runs for pair in _pairs(run, longest)), key=lambda pair: -pair[0])
    for first, end in pairwise((0, *LOOKS)):
        costs += [cost for _, run, a, b in pairs[first:end] if (cost := _costs(run, a, b, hypotheses)) is not None]
        result = _decision(hypotheses, costs, turns.stated_sweep)
        if result.times is not None or end >= len(pairs):
            break
    return replace(result, stated_turn=turns.stated_turn, scan_period=turns.scan_period)


def _decision(hypotheses: Sequence[BeamTimes], costs: Sequence[tuple[float, ...]], stated: float) -> BeamOrderTest:
    """Compare the hypotheses by their costs over pairs of scans; `stated` is the stated duration of a sweep, seconds.

    The error probability is shared out among the looks.
    """
    if len(costs) < MIN_VALUES or len(hypotheses) == 1:
        return BeamOrderTest(None, len(costs), 0.0, stated)
    by_hypothesis = dict(zip(hypotheses, np.array(costs).T, strict=True))
    best = min(hypotheses, key=lambda times: float(by_hypothesis[times].mean()))
    better = {times: statistic(cost - by_hypothesis[best]) for times, cost in by_hypothesis.items() if times != best}
    opposite = better[_opposite(best, hypotheses)]
    levels = WRONG_ORDER_PROBABILITY / len(LOOKS), CONTRADICTION_PROBABILITY / len(LOOKS)
    limit, of_others = (upper_limit(level, len(costs) - 1) for level in levels)
    certain = opposite > limit and min(better.values()) > of_others
    return BeamOrderTest(best if certain else None, len(costs), opposite, stated)


def _opposite(times: BeamTimes, hypotheses: Sequence[BeamTimes]) -> BeamTimes:
    """Return the hypothesis with the opposite order of the beams; if there is none, the stated times or any others."""
    opposite = replace(times, reversed=not times.reversed)
    if opposite in hypotheses:
        return opposite
    return STATED if times != STATED else hypotheses[-1]


def _hypotheses(turns: Turns) -> list[BeamTimes]:
    """Return the times of beams that are compared, first the stated ones; others only if they are different."""
    stated, period = turns.stated_turn, turns.scan_period
    hypotheses = [STATED]
    if stated > 0.0:
        hypotheses += [BeamTimes(reversed=True), BeamTimes(0.0)]
    if abs(stated - period) > DIFFERENT * period:
        hypotheses += [BeamTimes(period), BeamTimes(period, reversed=True)]
    return hypotheses


def _pairs(run: Run, times: BeamTimes) -> list[tuple[float, Run, int, int]]:
    """Return pairs of scans as (difference of bending, run, first, second); no scan is in two pairs."""
    first, second = np.triu_indices(len(run.scans), 1)
    apart = np.hypot(*(run.poses[second, :2] - run.poses[first, :2]).T)
    near = apart < MAX_DISTANCE
    first, second = first[near], second[near]
    bending = _bending_difference(run, times, first, second)
    pairs: list[tuple[float, Run, int, int]] = []
    used: set[int] = set()
    for k in np.argsort(-bending):
        a, b = int(first[k]), int(second[k])
        if bending[k] < MIN_BENDING or len(pairs) >= LOOKS[-1]:
            break
        if not used & {a, b}:
            used |= {a, b}
            pairs.append((float(bending[k]), run, a, b))
    return pairs


def _bending_difference(run: Run, times: BeamTimes, first: Floats, second: Floats) -> Floats:
    """Return (p,) by how much de-skewing moves the two scans of each pair against each other, radians RMS.

    A beam at angle a is moved by the rotation rate times its time from the middle of the sweep; what is common to all
    directions is a rotation of the scan, and is left out.
    """
    directions = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    moved = np.array(
        [_moves(times.of(scan), rate, se2.wrap(directions - heading))
         for scan, rate, heading in zip(run.scans, run.twists[:, 2], run.poses[:, 2], strict=True)]
    )  # fmt: skip
    difference = moved[second] - moved[first]
    seen = np.isfinite(difference)
    count = np.maximum(seen.sum(axis=1), 1)
    filled = np.where(seen, difference, 0.0)
    mean = filled.sum(axis=1) / count
    return np.asarray(np.sqrt(np.maximum((filled**2).sum(axis=1) / count - mean**2, 0.0)))


def _moves(scan: Scan, rate: float, bearings: Floats) -> Floats:
    """Return (d,) the rotation of a scan's beams at the given bearings by de-skewing; NaN outside of its view."""
    angle = scan.angles[0] + (bearings - scan.angles[0]) % (2 * np.pi)
    times = np.interp(angle, scan.angles, scan.time_offsets - middle_offset(scan), right=np.nan)
    return np.asarray(rate * times)


def _costs(run: Run, first: int, second: int, hypotheses: Sequence[BeamTimes]) -> tuple[float, ...] | None:
    """Return the cost of a pair under each hypothesis, matched both ways; None if a match fails."""
    guess = se2.between(run.poses[first], run.poses[second])
    costs = []
    for times in hypotheses:
        points = [scan_points(times.of(run.scans[k]), run.twists[k]) for k in (first, second)]
        surfaces = [surface(one) for one in points]
        if surfaces[0] is None or surfaces[1] is None:
            return None
        there = match(points[1], surfaces[0], guess)
        back = match(points[0], surfaces[1], se2.inverse(guess))
        if there is None or back is None:
            return None
        costs.append(0.5 * (there.cost + back.cost))
    return tuple(costs)
