"""Decide from the scans in which order a lidar measured its beams.

Some drivers turn the beams of a message round, but not their times. De-skewing then bends the scans of a turning robot
twice as much as none would. Scans that are bent in different ways do not fit onto each other, so pairs of scans are
matched three times: de-skewed with the stated times, with reversed times, and with none. The motion during the sweep is
that of scan matching. The difference of the log-likelihoods of two hypotheses, taken over the pairs, has a mean and a
standard error; their ratio is Vuong's statistic for the comparison of models (Econometrica 57, 1989), here with
Student's distribution because the pairs are few.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .. import se2
from ..messages import Floats, Scan
from .scan_matching import match, middle_offset, scan_points, surface
from .student import statistic, upper_limit
from .turns import Run, Turns

Order = Literal["forward", "reversed"]
BeamOrder = Literal["auto", "forward", "reversed"]

# Pairs of scans that are matched, those that are bent most differently. Origin: chosen, for a second of computing.
MAX_PAIRS = 40
# Pairs for a decision at least. Origin: chosen; Student's quantiles for fewer are beyond any data.
MIN_PAIRS = 8
# Radians, least difference of bending within a pair. Origin: chosen, the usual noise of a bearing; not measured.
MIN_BENDING = 0.002
# Metres between the scans of a pair at most. Origin: chosen, they should show the same surfaces; not measured.
MAX_DISTANCE = 1.0
# Probability of a wrong decision if two orders explain the scans equally well.
# Origin: chosen, so that no user meets one.
ERROR_PROBABILITY = 1e-6
# Directions in which the bending of two scans is compared. Origin: numerical.
DIRECTIONS = 48
# Factors on the beams' times of the hypotheses: as stated, reversed, none. Origin: definition.
FACTORS = (1.0, -1.0, 0.0)


@dataclass(frozen=True, slots=True)
class BeamOrderTest:
    """Result of the comparison.

    order       order of the beams' times that explains the scans; None if nothing can be said
    pairs       number of pairs of scans
    statistic   log-likelihood of the stated order minus that of the reversed one, divided by its standard error
    """

    order: Order | None
    pairs: int
    statistic: float


def decide_beam_order(turns: Turns) -> BeamOrderTest:
    """Compare the orders over the turns of a drive.

    The times are reversed only if that explains the scans significantly better than the stated order, and than none.
    """
    pairs = sorted((pair for run in turns.runs for pair in _pairs(run)), key=lambda pair: -pair[0])[:MAX_PAIRS]
    costs = [cost for _, run, first, second in pairs if (cost := _costs(run, first, second)) is not None]
    if len(costs) < MIN_PAIRS:
        return BeamOrderTest(None, len(costs), 0.0)
    stated, reversed_, none = np.array(costs).T
    limit = upper_limit(ERROR_PROBABILITY, len(costs) - 1)
    preference = statistic(reversed_ - stated)
    order: Order | None = None
    if preference > limit:
        order = "forward"
    elif preference < -limit and statistic(none - reversed_) > limit:
        order = "reversed"
    return BeamOrderTest(order, len(costs), preference)


def _pairs(run: Run) -> list[tuple[float, Run, int, int]]:
    """Return pairs of scans as (difference of bending, run, first, second); no scan is in two pairs."""
    first, second = np.triu_indices(len(run.scans), 1)
    apart = np.hypot(*(run.poses[second, :2] - run.poses[first, :2]).T)
    near = apart < MAX_DISTANCE
    first, second = first[near], second[near]
    bending = _bending_difference(run, first, second)
    pairs: list[tuple[float, Run, int, int]] = []
    used: set[int] = set()
    for k in np.argsort(-bending):
        a, b = int(first[k]), int(second[k])
        if bending[k] < MIN_BENDING or len(pairs) >= MAX_PAIRS:
            break
        if not used & {a, b}:
            used |= {a, b}
            pairs.append((float(bending[k]), run, a, b))
    return pairs


def _bending_difference(run: Run, first: Floats, second: Floats) -> Floats:
    """Return (p,) by how much de-skewing moves the two scans of each pair against each other, radians RMS.

    A beam at angle a is moved by the rotation rate times its time from the middle of the sweep; what is common to all
    directions is a rotation of the scan, and is left out.
    """
    directions = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    moved = np.array(
        [_moves(scan, rate, se2.wrap(directions - heading))
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


def _costs(run: Run, first: int, second: int) -> tuple[float, ...] | None:
    """Return the cost of a pair under each hypothesis, matched both ways; None if a match fails."""
    guess = se2.between(run.poses[first], run.poses[second])
    costs = []
    for factor in FACTORS:
        points = [scan_points(run.scans[k], run.twists[k], factor) for k in (first, second)]
        surfaces = [surface(one) for one in points]
        if surfaces[0] is None or surfaces[1] is None:
            return None
        there = match(points[1], surfaces[0], guess)
        back = match(points[0], surfaces[1], se2.inverse(guess))
        if there is None or back is None:
            return None
        costs.append(0.5 * (there.cost + back.cost))
    return tuple(costs)
