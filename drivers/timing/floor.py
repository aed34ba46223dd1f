"""Find a lidar that is not level and sees the floor.

The plane of the beams meets the floor in a straight line. This line is fixed in the lidar's frame, and no return lies
beyond it. A wall is fixed in the building instead, so its line turns in the lidar's frame while the robot turns.

A scan is compared with the one before a turn of MIN_TURN within MAX_DRIVEN. It supports a line on two conditions.
First, returns lie on the line in space that the scan before the turn saw through: so these returns are no surface that
stands still. Second, nearly none of the returns in the sector around the line lie beyond it; the scan contradicts the
line if more do. If the robot nods, the line moves by some percent, so a scan also supports the lines near the one that
it shows. With the probabilities of both outcomes, for the floor (F) and for any other line (O), a line is the floor if

    n log(P(support | F) / P(support | O)) + m log(P(contradiction | F) / P(contradiction | O)) > log(lines / p)

for n scans that support and m that contradict it; p is the probability of an error in any of the lines that are tried.

A wall that the robot drives along is fixed in the lidar's frame, too, and if odometry turns by mistake, it seems to be
where the scan before saw through. So a scan says nothing of a line if the returns on the opposite side of the lidar,
where this floor cannot be, agree better with the scan before if the robot has not moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .. import se2
from ..compiled import compiled, inlined
from ..immutable import immutable
from ..messages import Floats, Message, Odometry, Scan
from .student import ERROR_PROBABILITY

# Radians of a turn between two scans that are compared. Origin: chosen; a wall's line then leaves the tolerance within
# a metre of its nearest point, and a turn by a right angle gives four of them.
MIN_TURN = math.radians(20.0)
# Metres driven in this turn at most. Origin: chosen; farther on, the robot sees what was hidden.
MAX_DRIVEN = 1.0
# Directions in which a scan has one range each. Origin: chosen, 2 degrees; a sparser lidar leaves some without.
BINS = 180
# Bins from one direction of the lines that are tried to the next. Origin: chosen, 4 degrees.
STRIDE = 2
# Bins of the sector around a line's direction, to either side: 60 degrees. Origin: chosen; at its edge, the floor is
# twice as far away.
SECTOR = 30
# Logarithms (2 SECTOR + 1,) of the distances to a line, as parts of the ranges in the bins of its sector.
# Origin: geometry.
LOG_COSINES = np.log(np.cos(np.arange(-SECTOR, SECTOR + 1) * 2.0 * math.pi / BINS))
# Metres of the nearest line, factor from one line to the next, and number of lines in one direction: up to 16 m.
# Origin: chosen; nearer, parts of the robot may be in view, and few halls show a floor farther away.
MIN_DISTANCE, FACTOR, DISTANCES = 1.0, 1.02, 140
# Lines to either side within which a return is on a line: 4 percent. Origin: chosen, the noise of cheap lidars.
TOLERANCE = 2
# Lines to either side, nearer or farther and turned, that are the same line while the robot nods: 15 percent and 8
# degrees. Origin: geometry, a lidar that is tilted by 2 degrees and nods by 0.3 degrees.
NOD, NOD_TURN = 7, 2
# Part of the range, and metres, by which a return must be nearer than what the scan before the turn saw there.
# Origin: chosen, the errors of odometry in the turn.
MARGIN = (0.05, 0.1)
# Returns on a line in space that was seen through, to support it. Origin: chosen, 10 degrees; people are narrower.
MIN_RETURNS = 5
# Share of the returns on a line or beyond that lie on it, to support it. Origin: chosen; some are reflected.
MIN_ON_LINE = 0.95
# Share and number of the same that lie beyond a line, to contradict it. Origin: chosen, above what is reflected.
MIN_BEYOND, MIN_BEYOND_RETURNS = 0.1, 3
# Probability that a scan supports the line of the floor, if it supports or contradicts it. Origin: chosen, for a
# robot that nods more than that when it starts or stops.
SUPPORT_BY_FLOOR = 0.9
# The same for any other line. Origin: measured, on 29 recordings and 35 simulated drives: of all lines of a drive, the
# one with the largest share has at most 5 of 30, in the mean over the lines of a drive it is far less.
SUPPORT_BY_OTHERS = 0.05
# Share of the returns from the floor that may be nearer than where it is said to begin.
# Origin: chosen, a small part; some of these returns are from objects.
NEARER = 0.05


@dataclass(frozen=True, slots=True)
class Floor:
    """The floor in view of a lidar.

    distance  metres to the nearest point of the floor's line, on average
    nearest   metres beyond which it nearly always is
    bearing   radians in [-pi, pi), of that point in the lidar's frame
    scans     number of compared scans that show it
    """

    distance: float
    nearest: float
    bearing: float
    scans: int

    @property
    def safe_range(self) -> float:
        """Range in metres within which the lidar sees no floor, in decimetres."""
        return math.floor(10.0 * self.nearest) / 10.0

    def left_out(self, scan: Scan) -> Scan:
        """Return a scan without the returns on the floor."""
        ahead = scan.ranges * np.cos(scan.angles - self.bearing)
        return replace(scan, ranges=np.where(ahead < self.nearest, scan.ranges, np.nan))

    def __str__(self) -> str:
        return (
            f"the lidar is not level: it sees the floor in a line {self.distance:.1f} m away at a bearing of "
            f"{math.degrees(self.bearing):z.0f} degrees, which turned with the robot in {self.scans} scans, as no wall "
            "does"
        )


@immutable
class _View:
    """Odometry pose, and logarithms (BINS,) of the ranges in a scan, NaN where nothing is known."""

    pose: se2.Pose
    logs: Floats


class FloorDetector:
    """Detector that is given all messages of a drive in time order; only scans of the first lidar count."""

    def __init__(self) -> None:
        self._pose: se2.Pose | None = None
        self._before: _View | None = None
        self._returns, self._supports, self._contradictions = (
            np.zeros((BINS // STRIDE, DISTANCES), dtype=np.int32) for _ in range(3)
        )

    def add(self, message: Message) -> None:
        """Process the next message."""
        if isinstance(message, Odometry):
            self._pose = message.pose
        elif isinstance(message, Scan) and message.lidar == 0 and self._pose is not None:
            self._add(message, self._pose)

    def _add(self, scan: Scan, pose: se2.Pose) -> None:
        before = self._before
        if before is None:
            self._before = _View(pose, _logs(scan.ranges, scan.angles))
            return
        x, y, heading = (pose - before.pose).tolist()
        driven = math.hypot(x, y)
        if driven <= MAX_DRIVEN and abs(math.remainder(heading, 2.0 * math.pi)) < MIN_TURN:
            return
        self._before = _View(pose, _logs(scan.ranges, scan.angles))
        if driven <= MAX_DRIVEN:
            motion = se2.between(before.pose, pose)
            if scan.mount is not None:
                motion = se2.compose(se2.between(scan.mount, motion), scan.mount)
            _judge(self._before.logs, before.logs, motion, self._returns, self._supports, self._contradictions)

    def found(self) -> Floor | None:
        """Return the floor; None if it is not in view, or the drive does not show it."""
        scores = self._supports * math.log(SUPPORT_BY_FLOOR / SUPPORT_BY_OTHERS) + self._contradictions * math.log(
            (1.0 - SUPPORT_BY_FLOOR) / (1.0 - SUPPORT_BY_OTHERS)
        )
        if scores.max() <= math.log(scores.size / ERROR_PROBABILITY):
            return None
        best = np.where(scores == scores.max(), self._returns, -1)
        direction, line = np.unravel_index(np.argmax(best), best.shape)
        turns, steps = np.arange(-NOD_TURN, NOD_TURN + 1), np.arange(-NOD, NOD + 1)
        returns = self._returns[np.ix_((direction + turns) % len(scores), line + steps)]
        bearing = STRIDE * (direction + np.average(turns, weights=returns.sum(axis=1))) + 0.5
        lines = line + 0.5 + steps
        distances = MIN_DISTANCE * FACTOR**lines
        share = np.cumsum(returns.sum(axis=0)) / returns.sum()
        return Floor(
            distance=float(np.average(distances, weights=returns.sum(axis=0))),
            nearest=float(distances[np.searchsorted(share, NEARER)]) / FACTOR**TOLERANCE,
            bearing=float(se2.wrap(bearing * 2.0 * math.pi / BINS)),
            scans=int(self._supports[direction, line]),
        )


def warm_up() -> None:
    """Compile the functions of the detector, or load them from the cache."""
    angles = np.arange(-math.pi, math.pi, 2.0 * math.pi / BINS)
    angles.flags.writeable = False  # as of scans from recordings, for which functions are compiled
    detector, scan = FloorDetector(), Scan(0.0, np.ones(BINS), angles, np.zeros(BINS), 0.0, np.inf)
    for heading in (0.0, 2.0 * MIN_TURN):
        detector.add(Odometry(0.0, np.array([0.0, 0.0, heading])))
        detector.add(scan)


@compiled
def _logs(ranges, angles):  # type: ignore[no-untyped-def]
    """Return the logarithm (BINS,) of a range in each direction; NaN where there is no return."""
    logs = np.full(BINS, np.nan)
    for k in range(len(ranges)):
        if ranges[k] > 0.0 and ranges[k] < np.inf:
            logs[math.floor(angles[k] / (2.0 * math.pi) * BINS) % BINS] = math.log(ranges[k])
    return logs


@compiled
def _judge(logs, before, motion, returns, supports, contradictions):  # type: ignore[no-untyped-def]
    """Count a scan for or against each line (BINS / STRIDE, DISTANCES), and add the returns on those it supports."""
    through, agree = np.zeros(BINS, dtype=np.bool_), np.zeros(BINS, dtype=np.bool_)
    _compare_views(logs, before, motion, through, agree)
    ignored, agree_unmoved = np.zeros(BINS, dtype=np.bool_), np.zeros(BINS, dtype=np.bool_)
    _compare_views(logs, before, np.zeros(3), ignored, agree_unmoved)
    supported, contradicted = np.zeros(supports.shape, dtype=np.bool_), np.zeros(supports.shape, dtype=np.bool_)
    counts, moved = np.empty(DISTANCES + 1), np.empty(DISTANCES + 1)
    for direction in range(len(supports)):
        if _turn_is_wrong(logs, agree, agree_unmoved, direction):
            continue
        _count_returns(logs, through, direction, counts, moved)
        _compare(counts, moved, returns[direction], supported[direction], contradicted[direction])
    for direction in range(len(supports)):
        last_supported = -DISTANCES  # of the lines up to `far`, in directions that are the same while the robot nods
        for far in range(DISTANCES):
            for turned in range(direction - NOD_TURN, direction + NOD_TURN + 1):
                if supported[turned % len(supports), far]:
                    last_supported = far
            line = far - NOD
            if line >= NOD and last_supported >= line - NOD:
                supports[direction, line] += 1
            elif line >= NOD and contradicted[direction, far]:
                contradictions[direction, line] += 1


@inlined
def _compare_views(logs, before, motion, through, agree):  # type: ignore[no-untyped-def]
    """Mark (BINS,) which returns lie in space that the scan before saw through, and which where it saw something.

    motion  (3,) of the lidar since the scan before
    """
    for k in range(BINS):
        if math.isnan(logs[k]):
            continue
        bearing, distance = (k + 0.5) * 2.0 * math.pi / BINS + motion[2], math.exp(logs[k])
        x, y = motion[0] + distance * math.cos(bearing), motion[1] + distance * math.sin(bearing)
        middle, nearest, farthest = math.floor(math.atan2(y, x) / (2.0 * math.pi) * BINS), np.inf, -np.inf
        for i in range(middle - 1, middle + 2):
            if before[i % BINS] < nearest:
                nearest = before[i % BINS]
            if before[i % BINS] > farthest:
                farthest = before[i % BINS]
        if nearest < np.inf:
            moved_to = math.hypot(x, y)
            through[k] = moved_to < (1.0 - MARGIN[0]) * math.exp(nearest) - MARGIN[1]
            agree[k] = not through[k] and moved_to < (1.0 + MARGIN[0]) * math.exp(farthest) + MARGIN[1]


@inlined
def _turn_is_wrong(logs, agree, agree_unmoved, direction):  # type: ignore[no-untyped-def]
    """Return True if the returns opposite to a direction agree better with the scan before without any motion."""
    moved, unmoved = 0, 0
    for offset in range(BINS // 4 + 1, BINS - BINS // 4):
        k = (STRIDE * direction + offset) % BINS
        if logs[k] > math.log(MIN_DISTANCE):  # false for NaN; nearer, parts of the robot may be in view
            moved += agree[k]
            unmoved += agree_unmoved[k]
    return unmoved > moved


@inlined
def _count_returns(logs, through, direction, counts, moved):  # type: ignore[no-untyped-def]
    """Count the returns between each line in a direction and the next one (DISTANCES + 1,), and those seen through.

    The last count is that beyond all lines.
    """
    counts[:], moved[:] = 0.0, 0.0
    for offset in range(-SECTOR, SECTOR + 1):
        k = (STRIDE * direction + offset) % BINS
        along = (logs[k] + LOG_COSINES[offset + SECTOR] - math.log(MIN_DISTANCE)) / math.log(FACTOR)
        if along >= 0.0:  # false for NaN
            line = min(math.floor(along), DISTANCES)
            counts[line] += 1.0
            moved[line] += through[k]


@inlined
def _compare(counts, moved, returns, supported, contradicted):  # type: ignore[no-untyped-def]
    """Mark the lines (DISTANCES,) in a direction that a scan supports, and those it contradicts, without nodding.

    The returns on the lines that it supports are added to `returns`.
    """
    beyond = counts[DISTANCES]
    for line in range(DISTANCES - 1 - TOLERANCE, TOLERANCE - 1, -1):
        on_line, of_moved = 0.0, 0.0
        for near in range(line - TOLERANCE, line + TOLERANCE + 1):
            on_line += counts[near]
            of_moved += moved[near]
        if of_moved >= MIN_RETURNS and on_line >= MIN_ON_LINE * (on_line + beyond):
            supported[line] = True
            returns[line] += on_line
        elif beyond >= MIN_BEYOND_RETURNS and beyond > MIN_BEYOND * (on_line + beyond):
            contradicted[line] = True
        beyond += counts[line + TOLERANCE]
