"""Find returns from the robot itself: posts, plates and cables in the plane of its lidar.

They are fixed in the lidar's frame. So the beams in their direction end at the same distance in every scan, and never
beyond, however the robot turns. What stands in the building is elsewhere in the lidar's frame after a turn.

Scans are compared that are at least MIN_TURN apart. A scan supports a distance in a direction if the farthest return
there is at this distance, and contradicts it otherwise. With the probabilities of a support by the robot (R) and by
anything else (O), the robot is there if

    n log(P(support | R) / P(support | O)) + m log(P(contradiction | R) / P(contradiction | O)) > log(places / p)

for n scans that support and m that contradict; p is the probability of an error in any of the directions and distances
that are tried. Besides, it must be seen nearly always.

Walls that the robot drives along are fixed in the lidar's frame, too, and odometry may turn by mistake. So a scan
counts only if most of what is farther away than any part of the robot differs from the compared scan before.

Without odometry, the scans tell the turn: most of what is farther away than any part of the robot is the same again if
one of them is turned by MIN_TURN or more, and not if it is turned by less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .. import se2
from ..compiled import compiled
from ..messages import Floats, Message, Odometry, Scan
from .student import ERROR_PROBABILITY

# Radians of a turn between two scans that are compared. Origin: geometry; a wall across a beam of 0.2 m is then 3 cm
# farther away along the beam.
MIN_TURN = math.radians(30.0)
# Directions that are decided on separately. Origin: chosen, 2 degrees; a sparser lidar leaves some without returns.
BINS = 180
# Metres of a distance, and number of distances: parts of a robot are less than a metre from its lidar. Origin: chosen.
CELL, CELLS = 0.01, 100
# Distances to either side that are the same. Origin: chosen, 2 cm, the noise and the steps of cheap lidars.
TOLERANCE = 2
# Part of the range by which a return farther away differs. Origin: geometry; in a turn by MIN_TURN a wall ahead is 15
# percent farther away.
MIN_CHANGE = 0.05
# The same for two scans that are turned to fit each other: the robot drives some decimetres meanwhile. Origin: chosen.
MIN_CHANGE_IF_TURNED = 2.0 * MIN_CHANGE
# Directions in which both of two scans must show something farther away than any part of the robot, for the scans to
# tell the turn. Origin: chosen, 20 degrees: less may be people.
MIN_COMMON = 10
# Probability that a scan supports the distance of a part of the robot. Origin: chosen; some beams do not return.
SUPPORT_BY_ROBOT = 0.95
# The same for anything else, at the distance with most support. Origin: measured, in recordings of twelve robots 2 to
# 16 % in the mean over the directions, and at most 38 % in one of them.
SUPPORT_BY_OTHERS = 0.1
# Share of the compared scans that must support it, however many there are: a person may follow the robot for a while.
# Origin: chosen, between the two.
MIN_SHARE = 0.85
# Sectors that a text names. Origin: chosen, for a line of text.
MAX_NAMED = 4


@dataclass(frozen=True, eq=False)
class OwnReturns:
    """Returns of a lidar from the robot itself.

    limits  (BINS,) metres up to which returns are from the robot, in directions from 0 to 2 pi; 0 where it is not seen
    scans   number of compared scans that show it, in the direction with most
    """

    limits: Floats
    scans: int

    @property
    def farthest(self) -> float:
        """Metres up to which the robot is seen."""
        return float(self.limits.max())

    @property
    def safe_range(self) -> float:
        """Range in metres beyond which nothing of the robot is seen, in decimetres."""
        return math.ceil(10.0 * self.farthest) / 10.0

    def left_out(self, scan: Scan) -> Scan:
        """Return a scan without the returns from the robot, and those at the edges of its parts."""
        limits = np.maximum(self.limits, np.maximum(np.roll(self.limits, 1), np.roll(self.limits, -1)))
        return replace(scan, ranges=np.where(scan.ranges > limits[_bins(scan.angles)], scan.ranges, np.nan))

    @property
    def sectors(self) -> list[tuple[float, float]]:
        """Sectors in which it is seen: first and last bearing in the lidar's frame, radians in [-pi, pi)."""
        seen, width = self.limits > 0.0, 2.0 * math.pi / BINS
        if seen.all():
            return [(-math.pi, math.pi)]
        first = np.flatnonzero(seen & ~np.roll(seen, 1))
        last = np.flatnonzero(seen & ~np.roll(seen, -1))
        last = np.roll(last, -1) if len(last) and last[0] < first[0] else last  # the sector around the bearing 0
        ends = zip(se2.wrap(first * width).tolist(), se2.wrap((last + 1) * width).tolist(), strict=True)
        return sorted(ends)

    def __str__(self) -> str:
        degrees = [[f"{math.degrees(bearing):z.0f}" for bearing in sector] for sector in self.sectors]
        named = ", ".join(f"{first} to {last}" for first, last in degrees[:MAX_NAMED])
        more = f" and {len(degrees) - MAX_NAMED} more" if len(degrees) > MAX_NAMED else ""
        return (
            f"the lidar sees the robot itself, up to {self.farthest:.2f} m away at bearings of {named}{more} degrees: "
            f"the returns there were the same in {self.scans} scans between which the robot turned"
        )


class OwnReturnsDetector:
    """Detector that is given all messages of a drive in time order; only scans of the first lidar count."""

    def __init__(self) -> None:
        self._heading, self._compared = math.nan, math.nan  # radians, of odometry now and at the last compared scan
        self._before = np.zeros(BINS)  # metres, the farthest return of that scan in each direction
        self._counts, self._scans = np.zeros((BINS, CELLS), dtype=np.int32), 0

    def add(self, message: Message) -> None:
        """Process the next message."""
        if isinstance(message, Odometry):
            if math.isnan(self._heading):  # the scans before were compared otherwise
                self._counts[:], self._scans = 0, 0
            self._heading = float(message.pose[2])
        elif isinstance(message, Scan) and message.lidar == 0:
            if math.isnan(self._heading):
                self._compare_views(farthest_returns(message))
                return
            turned = abs(math.remainder(self._heading - self._compared, 2.0 * math.pi))
            if not turned < MIN_TURN:  # true for the first scan
                self._compare(farthest_returns(message))

    def _compare(self, farthest: Floats) -> None:
        """Count a scan if its view differs from that of the compared scan before.

        farthest  (BINS,) metres to the farthest return in each direction, 0 without any
        """
        before, self._before, self._compared = self._before, farthest, self._heading
        beyond = np.maximum(farthest, before) > CELL * CELLS
        change = np.abs(farthest - before) > MIN_CHANGE * np.maximum(farthest, before)
        if 2 * np.count_nonzero(beyond & change) > np.count_nonzero(beyond):
            self._count(farthest)

    def _compare_views(self, farthest: Floats) -> None:
        """Count a scan without odometry if its view is that of the compared scan, turned by MIN_TURN or more."""
        turn = _turn_between(farthest, self._before)
        if turn is None:  # the robot has driven on to where other things are seen
            self._before = farthest
        elif abs(turn) >= MIN_TURN:
            self._before = farthest
            self._count(farthest)

    def _count(self, farthest: Floats) -> None:
        """Count the distances of the farthest returns (BINS,) that may be from the robot."""
        self._scans += 1
        near = np.flatnonzero((farthest > 0.0) & (farthest < CELL * CELLS))
        self._counts[near, (farthest[near] / CELL).astype(np.int64)] += 1

    def found(self) -> OwnReturns | None:
        """Return what is seen of the robot; None if nothing is, or the drive does not show it."""
        padded = np.pad(self._counts, ((0, 0), (TOLERANCE, TOLERANCE)))
        supports = np.lib.stride_tricks.sliding_window_view(padded, 2 * TOLERANCE + 1, axis=1).sum(axis=2)
        contradictions = self._scans - supports
        scores = supports * math.log(SUPPORT_BY_ROBOT / SUPPORT_BY_OTHERS) + contradictions * math.log(
            (1.0 - SUPPORT_BY_ROBOT) / (1.0 - SUPPORT_BY_OTHERS)
        )
        scores[supports < MIN_SHARE * self._scans] = -np.inf
        best = scores.argmax(axis=1)
        seen = scores.max(axis=1) > math.log(scores.size / ERROR_PROBABILITY)
        if not seen.any():
            return None
        limits = np.where(seen, CELL * (best + 1 + TOLERANCE), 0.0)
        return OwnReturns(limits, int(supports[seen, best[seen]].max()))


def farthest_returns(scan: Scan) -> Floats:
    """Return the farthest return (BINS,) of a scan in each direction, metres; 0 without any."""
    return np.asarray(_farthest(scan.ranges, _bins(scan.angles)))


def warm_up() -> None:
    """Compile the functions of the detector, or load them from the cache."""
    angles = np.arange(-math.pi, math.pi, 2.0 * math.pi / BINS)
    detector, scan = OwnReturnsDetector(), Scan(0.0, np.ones(BINS), angles, np.zeros(BINS), 0.0, np.inf)
    _turn_between(np.full(BINS, 2.0), np.full(BINS, 3.0))
    detector.add(Odometry(0.0, np.zeros(3)))
    detector.add(scan)


def _turn_between(farthest: Floats, before: Floats) -> float | None:
    """Return the turn (radians) between two scans given by their farthest returns (BINS,).

    It is zero if most of what both show is at the same place, or if that is too little to tell. None if no turn fits,
    or if they show nothing in common.
    """
    same, common = _agreeing(farthest, before, 0, MIN_CHANGE)
    if 2 * same > common or 0 < common < MIN_COMMON:
        return 0.0
    shift = _best_shift(farthest, before)
    return None if shift == BINS else shift * 2.0 * math.pi / BINS


@compiled
def _best_shift(farthest, before):  # type: ignore[no-untyped-def]
    """Return the turn, in directions, by which a scan fits another one best; BINS if it fits after none.

    It fits if most of what both show beyond the robot agrees.
    """
    best, best_share = BINS, 0.5
    for shift in range(-(BINS // 2), BINS // 2):
        same, common = _agreeing(farthest, before, shift, MIN_CHANGE_IF_TURNED)
        if common >= MIN_COMMON and same > best_share * common:
            best, best_share = shift, same / common
    return best


@compiled
def _agreeing(farthest, before, shift, tolerance):  # type: ignore[no-untyped-def]
    """Return in how many directions a scan that is turned agrees with another one, and in how many both see far."""
    same, common = 0, 0
    for k in range(BINS):
        one, other = farthest[(k + shift) % BINS], before[k]
        if min(one, other) > CELL * CELLS:
            common += 1
            same += abs(one - other) <= tolerance * max(one, other)
    return same, common


def _bins(angles: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the number (n,) of the direction of each angle (n,)."""
    return np.floor(angles * (BINS / (2.0 * math.pi))).astype(np.int64) % BINS


@compiled
def _farthest(ranges, bins):  # type: ignore[no-untyped-def]
    """Return the farthest return (BINS,) in each direction, metres; 0 without any."""
    farthest = np.zeros(BINS)
    for k in range(len(ranges)):
        if ranges[k] < np.inf and ranges[k] > farthest[bins[k]]:  # false for NaN
            farthest[bins[k]] = ranges[k]
    return farthest
