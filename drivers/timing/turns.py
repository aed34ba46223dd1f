"""The turns of a drive: the parts in which the lidar's timing shows, with the lidar's motion from scan matching."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from .. import se2
from ..messages import Floats, Message, Odometry, Scan, YawRate
from .beam_times import BeamTimes
from .floor import Floor, FloorDetector
from .own_returns import OwnReturns, OwnReturnsDetector
from .scan_matching import find_rotation, match, middle_offset, scan_points, surface

# Seconds of a part of a drive. Origin: chosen, a turn with what is before and after it; not measured.
PART_DURATION = 6.0
# Scans that are matched, of the parts in which the robot turns most.
# Origin: chosen, for about a second of computing.
MAX_SCANS = 320
# Seconds between two scans at least; scans of faster lidars are thinned out.
# Origin: chosen, a turn between two scans should exceed the error of matching; not measured.
MIN_SCAN_PERIOD = 0.09
# Seconds between two scans at most, to be matched. Origin: chosen, a turning robot then sees something else.
MAX_SCAN_PERIOD = 0.6
# Radians, largest standard deviation of a measured rotation. Origin: chosen, a degree; not measured.
MAX_ROTATION_SIGMA = 0.02
# Radians, least view of a scan whose part of a turn is computed. Origin: numerical.
MIN_VIEW = 1e-3


@dataclass(frozen=True, eq=False)
class Run:
    """Consecutive scans, each of which was matched to the one before.

    scans    n scans
    stamps   (n,) of the middle of each sweep, seconds
    poses    (n, 3) of the lidar in the frame of the first scan; headings are not wrapped
    """

    scans: list[Scan]
    stamps: Floats
    poses: Floats

    @cached_property
    def twists(self) -> Floats:
        """(n, 3) velocity of the lidar at each scan [m/s, m/s, rad/s] in its own frame, from both neighbours."""
        steps = se2.between(self.poses[:-1], self.poses[1:])
        steps /= np.diff(self.stamps)[:, None]
        return np.concatenate([steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:]])


@dataclass(slots=True)
class _Part:
    """Part of a drive of PART_DURATION: its scans, and the range of the rotation rates in it."""

    scans: list[Scan] = field(default_factory=list)
    slowest: float = np.inf
    fastest: float = -np.inf

    @property
    def activity(self) -> float:
        """Change of the rotation rate, rad/s: a constant one shows no delay."""
        return max(0.0, self.fastest - self.slowest)


class Turns:
    """Turns of a drive, collected from its messages in time order; memory does not grow with the number of scans.

    Turns are found by odometry; without any, by a gyroscope, or else by the scans.

    odometry     (m, 2) stamps (seconds, increasing) and unwrapped headings (radians) of the whole drive
    positions    (m, 2) of the base at these stamps, metres
    rates        (k, 2) stamps (seconds, increasing) and rates of a gyroscope as recorded
    scans        number of scans of the drive
    mount        pose of the lidar on the robot that the first scan states; None if it states none
    scan_period  median seconds from scan to scan; 0 without two scans
    floor        the floor, if the lidar sees it in the drive
    own_returns  returns from the robot itself, if there are any
    """

    def __init__(self, messages: Iterable[Message]) -> None:
        self._parts: list[_Part] = []
        readings: list[tuple[float, float, float, float]] = []
        rates: list[tuple[float, float]] = []
        part, end, last = _Part(), -np.inf, -np.inf
        stamps: list[float] = []
        self.mount: se2.Pose | None = None
        floors, own = FloorDetector(), OwnReturnsDetector()
        for message in messages:
            floors.add(message)
            own.add(message)
            if isinstance(message, Scan):
                self.mount = self.mount if stamps else message.mount
                stamps.append(message.stamp)
                if message.stamp >= end:
                    self._keep(part, measured=bool(readings or rates))
                    part, end = _Part(), message.stamp + PART_DURATION
                if message.stamp >= last + MIN_SCAN_PERIOD:
                    part.scans.append(message)
                    last = message.stamp
            elif isinstance(message, Odometry):
                if not readings:
                    self._parts.clear()  # those before were found otherwise
                x, y, heading = message.pose.tolist()
                readings.append((message.stamp, heading, x, y))
                rate = _latest_rate(readings)
                part.slowest, part.fastest = min(part.slowest, rate), max(part.fastest, rate)
            elif isinstance(message, YawRate) and (not rates or message.stamp > rates[-1][0]):
                rates.append((message.stamp, message.rate))
                if not readings:
                    part.slowest, part.fastest = min(part.slowest, message.rate), max(part.fastest, message.rate)
        self._keep(part, measured=bool(readings or rates))
        self.floor: Floor | None = floors.found()
        self.own_returns: OwnReturns | None = own.found()
        self.scans = len(stamps)
        self.scan_period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
        self.rates = np.array(rates).reshape(-1, 2)
        path = _strictly_increasing(np.array(readings).reshape(-1, 4))
        self.odometry, self.positions = path[:, :2], path[:, 2:]

    def _keep(self, part: _Part, measured: bool) -> None:
        """Add a part, and drop those with the least activity if there are more scans than MAX_SCANS.

        measured  if turns are, by odometry or a gyroscope
        """
        if not measured and (rates := _rates_of_scans(part.scans)):
            part.slowest, part.fastest = min(rates), max(rates)
        if len(part.scans) < 2 or part.activity <= 0.0:
            return
        self._parts.append(part)
        self._parts.sort(key=lambda one: -one.activity)
        while sum(len(one.scans) for one in self._parts[:-1]) >= MAX_SCANS:
            self._parts.pop()

    def path_at(self, stamps: Floats) -> Floats:
        """Return the poses (n, 3) of the base by odometry at stamps (n,); headings are not wrapped."""
        columns = [*self.positions.T, self.odometry[:, 1]]
        return np.column_stack([np.interp(stamps, self.odometry[:, 0], column) for column in columns])

    @cached_property
    def stated_sweep(self) -> float:
        """Seconds from the first beam of a scan to the last, as stated: the median of the collected scans."""
        return self._median(lambda scan: scan.duration)

    @cached_property
    def stated_turn(self) -> float:
        """Seconds of a whole turn of the lidar by the stated times of beams: the median of the collected scans."""
        return self._median(lambda scan: scan.duration * 2.0 * np.pi / max(float(np.ptp(scan.angles)), MIN_VIEW))

    def _median(self, value: Callable[[Scan], float]) -> float:
        """Return the median of a value of the collected scans; 0 without any."""
        values = [value(scan) for part in self._parts for scan in part.scans if len(scan.angles)]
        return float(np.median(values)) if values else 0.0

    @cached_property
    def collected(self) -> list[Scan]:
        """Scans of the collected parts, in time order."""
        parts = sorted(self._parts, key=lambda one: one.scans[0].stamp)
        return [scan for part in parts for scan in part.scans]

    @cached_property
    def runs(self) -> list[Run]:
        """Runs of matched scans in the collected parts, in time order."""
        return _matched_runs(self.collected)


def _latest_rate(readings: list[tuple[float, float, float, float]]) -> float:
    """Return the mean rotation rate over MIN_SCAN_PERIOD or more up to the last reading, rad/s; zero after a gap."""
    stamp, heading, *_ = readings[-1]
    for earlier, before, *_ in reversed(readings[-20:-1]):
        if stamp - earlier >= MIN_SCAN_PERIOD:
            return float(se2.wrap(heading - before)) / (stamp - earlier) if stamp - earlier < MAX_SCAN_PERIOD else 0.0
    return 0.0


def _rates_of_scans(scans: Sequence[Scan]) -> list[float]:
    """Return the rotation rates from scan to scan, rad/s."""
    return [
        find_rotation(scan, before) / (scan.stamp - before.stamp)
        for before, scan in pairwise(scans)
        if scan.stamp - before.stamp < MAX_SCAN_PERIOD
    ]


def _strictly_increasing(readings: Floats) -> Floats:
    """Return the readings (m, 4) without repeated stamps, headings unwrapped."""
    later = np.concatenate([[True], np.diff(readings[:, 0]) > 0.0])[: len(readings)]
    return np.column_stack([readings[later, 0], np.unwrap(readings[later, 1]), readings[later, 2:]])


def _matched_runs(scans: list[Scan]) -> list[Run]:
    """Match each scan to the one before; a failed match ends a run. Runs of fewer than three scans are dropped."""
    if not scans:
        return []
    guesses = [None, *(_guess(*pair) for pair in pairwise(scans))]
    return _chain(scans, [scan_points(scan) for scan in scans], guesses)


def deskewed(run: Run, times: BeamTimes) -> list[Run]:
    """Match the scans of a run again, with these times of their beams, de-skewed with the motion from the first match.

    A scan that is not de-skewed shows where the lidar was when it measured the surfaces that determined the match,
    which need not be the middle of the sweep. A failed match ends a run.
    """
    scans = [times.of(scan) for scan in run.scans]
    if not any(scan.time_offsets.any() for scan in scans):
        return [run]
    points = [scan_points(scan, twist) for scan, twist in zip(scans, run.twists, strict=True)]
    return _chain(scans, points, [None, *se2.between(run.poses[:-1], run.poses[1:])])


def _chain(scans: list[Scan], points: list[Floats], guesses: Sequence[se2.Pose | None]) -> list[Run]:
    """Match the points of each scan to those of the scan before, starting from a guess; None ends a run."""
    runs: list[tuple[list[Scan], list[se2.Pose]]] = []
    for k, (scan, guess) in enumerate(zip(scans, guesses, strict=True)):
        motion = None if guess is None else _motion(points[k - 1], points[k], guess)
        if motion is None:
            runs.append(([scan], [np.zeros(3)]))
            continue
        of_run, poses = runs[-1]
        following = se2.compose(poses[-1], motion)
        following[2] = poses[-1][2] + motion[2]
        of_run.append(scan)
        poses.append(following)
    return [
        Run(of_run, np.array([scan.stamp + middle_offset(scan) for scan in of_run]), np.array(poses))
        for of_run, poses in runs
        if len(of_run) > 2
    ]


def _guess(before: Scan, scan: Scan) -> se2.Pose | None:
    """Return a first estimate of a scan's pose in the frame of the scan before it; None if that is long ago."""
    if scan.stamp - before.stamp > MAX_SCAN_PERIOD:
        return None
    return np.array([0.0, 0.0, find_rotation(scan, before)])


def _motion(before: Floats, points: Floats, guess: se2.Pose) -> se2.Pose | None:
    """Return the pose of a scan in the frame of the scan before it, from the points of both; None without a match."""
    reference = surface(before)
    found = None if reference is None else match(points, reference, guess)
    return None if found is None or found.sigma > MAX_ROTATION_SIGMA else found.pose
