"""Odometry readings of a run, and the pose of the base between them."""

from __future__ import annotations

import bisect
import math
from array import array
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drivers import se2
from drivers.messages import Odometry

from ..geometry.growing_array import GrowingArray
from ..geometry.normal_distribution import NORMAL_SCALE
from ..geometry.segments import Floats, Integers
from .measurement_clock import USUAL_PERIOD

# Seconds before the first reading for which the robot is taken to have moved evenly: before, it is taken to have stood.
# Origin: chosen, a little longer than an Arduino boots when its port is opened.
MAX_EXTENSION = 2.0
# Radians: a turn between two poses of odometry is certain up to this. One of more than half a turn seems to be smaller
# and in the other direction. Origin: definition, half of that.
QUARTER_TURN = 0.5 * math.pi
# Metres of wheel travel of a motion, at least: shorter ones are mostly the noise of odometry, or of registration.
# Origin: chosen, above the accuracy of registration; not measured.
MIN_MOTION_TRAVEL = 0.05
# Metres of travel that one radian of turning counts for: about half the distance between a robot's wheels, and a bit.
# Origin: geometry, wheels of small robots are 0.2 to 0.4 m apart.
TRAVEL_PER_RADIAN = 0.25
# Readings of a long run that are processed at once, so that it needs little memory. Origin: numerical.
BLOCK = 1 << 16
# Triples of readings that show the error of their stamps, at least. Origin: chosen, for a median; not measured.
MIN_TRIPLES = 16
# Metres per second of wheel travel above which readings show the error of their stamps, and below which they may show
# jitter. Origin: chosen, an encoder's step of 0.2 mm then looks like 2 ms.
MIN_SPEED = 0.1
# Readings from which the error of stamps is estimated, and after how many it is estimated again. Origin: numerical.
ESTIMATED_FROM, ESTIMATED_EVERY = 512, 64


class Paths(NamedTuple):
    """Paths from each of n readings to the next one, see `OdometryHistory.path`.

    nodes        (m, 3) all poses in between
    first, last  (n - 1,) the nodes of a path are those from `first` to before `last`
    """

    nodes: Floats
    first: Integers
    last: Integers


class OdometryHistory:
    """All odometry readings of a run, in time order."""

    def __init__(self) -> None:
        self._stamps, self._poses = GrowingArray(()), GrowingArray((3,))
        self._measured_from = -np.inf  # seconds, the first reading that `extend_back` did not prepend
        self._stamp_error, self._estimated_at = 0.0, 0  # and the number of readings when it was estimated
        self._node_stamps, self._nodes, self._passed = array("d"), GrowingArray((3,)), 0  # see `path`

    @classmethod
    def from_arrays(cls, stamps: Floats, poses: Floats) -> OdometryHistory:
        """Build a history from stamps (n,) in increasing order and poses (n, 3)."""
        history = cls()
        history._stamps.replace(stamps)
        history._poses.replace(poses)
        return history

    @classmethod
    def joined(cls, histories: Sequence[OdometryHistory]) -> OdometryHistory:
        """Return the readings of several histories, one after the other in time order, in one."""
        if len(histories) == 1:
            return histories[0]
        stamps, poses = [history.stamps for history in histories], [history.poses for history in histories]
        return cls.from_arrays(np.concatenate([[], *stamps]), np.concatenate([np.zeros((0, 3)), *poses]))

    def copy(self) -> OdometryHistory:
        """Return a copy that later readings do not change; it shares the present ones."""
        other = OdometryHistory()
        other._stamps, other._poses = self._stamps.copy(), self._poses.copy()
        other._measured_from = self._measured_from
        return other

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, reading: Odometry) -> None:
        """Append a reading; one that is not later than the last replaces its pose."""
        if reading.stamp <= self.latest:
            self._poses.overwrite_last(reading.pose)
            return
        self._stamps.append(reading.stamp)
        self._poses.append(reading.pose)

    def extend_back(self, stamp: float) -> None:
        """Prepend readings back to a stamp, as if the robot had moved as evenly before the first one as after it."""
        if len(self) < 2:
            return
        first, pose = self.earliest, self._pose(0)
        span = min(USUAL_PERIOD, self.latest - first)
        back = se2.inverse(USUAL_PERIOD / span * se2.between(pose, self.at(first + span)))
        stamps, poses, begin = list[float](), list[se2.Pose](), max(stamp, first - MAX_EXTENSION)
        for k in range(math.ceil((first - begin) / USUAL_PERIOD)):
            later = first - k * USUAL_PERIOD
            part = min(later - begin, USUAL_PERIOD)
            pose = se2.compose(pose, part / USUAL_PERIOD * back)
            stamps.insert(0, later - part)
            poses.insert(0, pose)
        if stamp < stamps[0]:
            stamps.insert(0, stamp)
            poses.insert(0, poses[0])
        self._stamps.replace([*stamps, *self._stamps.rows])
        self._poses.replace([*poses, *self._poses.rows])
        self._measured_from = first
        self._node_stamps, self._nodes, self._passed = array("d"), GrowingArray((3,)), 0

    @property
    def earliest(self) -> float:
        """Stamp of the first reading, inf without one."""
        return float(self._stamps.rows[0]) if len(self) else np.inf

    @property
    def latest(self) -> float:
        """Stamp of the last reading, -inf without one."""
        return float(self._stamps.rows[-1]) if len(self) else -np.inf

    @property
    def stamps(self) -> Floats:
        """(n,) seconds; not to be changed."""
        return self._stamps.rows

    @property
    def measured_stamps(self) -> Floats:
        """(m,) seconds, without those of the readings that `extend_back` prepended; not to be changed."""
        return self.stamps[bisect.bisect_left(self.stamps, self._measured_from) :]

    @property
    def poses(self) -> Floats:
        """(n, 3) in the odometry's frame."""
        return self._poses.rows.copy()

    def stamp_error(self, stamp: float) -> float:
        """Return the standard deviation of the stamps of the readings up to a stamp, seconds; see `error_of_stamps`.

        It does not depend on what was received later. It is estimated from ESTIMATED_FROM readings at most, and again
        after ESTIMATED_EVERY.
        """
        count = bisect.bisect_left(self.stamps, stamp)
        end = count - count % ESTIMATED_EVERY
        if end != self._estimated_at:
            begin = max(0, end - ESTIMATED_FROM)
            self._stamp_error = error_of_stamps(self.stamps[begin:end], self._poses.rows[begin:end])
            self._estimated_at = end
        return self._stamp_error

    def readings_between(self, begin: float, end: float) -> tuple[Floats, Floats]:
        """Return stamps (n,) and poses (n, 3) of the readings from `begin` (seconds) to the first one from `end` on."""
        first, last = bisect.bisect_left(self.stamps, begin), bisect.bisect_left(self.stamps, end) + 1
        return self.stamps[first:last], self._poses.rows[first:last].copy()

    def path(self, begin: Odometry, end: Odometry) -> Floats:
        """Return (n, 3) the path from one reading to another, both included.

        In between are readings that are MIN_MOTION_TRAVEL apart at least, so that jitter is not taken for travel.
        """
        self._add_nodes()
        stamps = self._node_stamps
        first, last = bisect.bisect_right(stamps, begin.stamp), bisect.bisect_left(stamps, end.stamp)
        poses = np.empty((max(last - first, 0) + 2, 3))
        poses[0], poses[1:-1], poses[-1] = begin.pose, self._nodes.rows[first:last], end.pose
        return poses

    def paths(self, stamps: Floats) -> Paths:
        """Return the nodes of the paths between readings with the given stamps (n,), which increase."""
        self._add_nodes()
        nodes = np.array(self._node_stamps)
        first, last = np.searchsorted(nodes, stamps[:-1], side="right"), np.searchsorted(nodes, stamps[1:])
        return Paths(self._nodes.rows, first, np.maximum(first, last))

    def _add_nodes(self) -> None:
        """Add the nodes of the path among the latest readings; the last reading, which may change, is none yet."""
        count = len(self._stamps) - 1
        if self._passed >= count:
            return
        from ..geometry.pose_arrays import spaced_rows  # compiled code, which reports do without

        last = self._nodes.rows[-1] if self._node_stamps else self._poses.rows[0]
        poses = self._poses.rows[self._passed : count]
        for row in spaced_rows(last, poses, MIN_MOTION_TRAVEL, TRAVEL_PER_RADIAN).tolist():
            self._node_stamps.append(float(self._stamps.rows[self._passed + row]))
            self._nodes.append(poses[row])
        self._passed = count

    def blocks(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield stamps (n,) and poses (n, 3) of all readings, up to BLOCK at a time."""
        for begin in range(0, len(self), BLOCK):
            yield self.stamps[begin : begin + BLOCK], self._poses.rows[begin : begin + BLOCK].copy()

    @property
    def travelled(self) -> Floats:
        """(n,) metres of wheel travel up to each reading."""
        travel = np.zeros(len(self))
        for begin in range(0, len(self) - 1, BLOCK):
            poses = self._poses.rows[begin : begin + BLOCK + 1]
            travel[begin + 1 : begin + len(poses)] = wheel_travel(se2.between(poses[:-1], poses[1:]))
        return np.cumsum(travel)

    def at(self, stamp: float) -> se2.Pose:
        """Return the pose at a stamp, interpolated linearly in SE(2); constant before the first and after the last."""
        stamps = self.stamps
        after = bisect.bisect_left(stamps, stamp)
        if after == len(stamps):
            return self._pose(after - 1)
        if after == 0 or stamps[after] == stamp:
            return self._pose(after)
        before = self._pose(after - 1)
        part = (stamp - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        return se2.compose(before, part * se2.between(before, self._pose(after)))

    def at_each(self, stamps: Floats) -> Floats:
        """Return (n, 3) the poses at several stamps."""
        from ..geometry.pose_arrays import interpolate_each  # compiled code, which reports do without

        stamps = np.array(stamps, dtype=np.float64, order="C")  # not read-only, which would be compiled for separately
        if not len(stamps):
            return np.zeros((0, 3))
        # Only the readings around: a scan must not take longer the longer the robot has been driving.
        begin = max(bisect.bisect_left(self.stamps, stamps.min()) - 1, 0)
        end = bisect.bisect_left(self.stamps, stamps.max()) + 1
        return np.asarray(interpolate_each(self.stamps[begin:end], self._poses.rows[begin:end], stamps))

    def _pose(self, reading: int) -> se2.Pose:
        return np.array(self._poses.rows[reading])


def wheel_travel(motion: se2.Pose) -> Floats:
    """Return (...,) the metres that the wheels roll in motions (..., 3): the length, plus a share for turning."""
    if motion.ndim == 1:  # in a third of the time; the absolute value of a complex number is C's hypot, as NumPy's is
        x, y, turn = motion.tolist()
        return np.asarray(abs(complex(x, y)) + TRAVEL_PER_RADIAN * abs(turn))
    return np.asarray(np.hypot(motion[..., 0], motion[..., 1]) + TRAVEL_PER_RADIAN * np.abs(motion[..., 2]))


def error_of_stamps(stamps: Floats, poses: Floats) -> float:
    """Return the standard deviation of the stamps of odometry readings, seconds; zero if too few show it.

    stamps  (n,) seconds, increasing
    poses   (n, 3)

    A reading that is stamped t too late while the wheels roll at the speed v is off by v t, see `deviations_of_triples`
    of the travelled distances. The median over all triples ignores slips, gaps and phases of acceleration.
    """
    if len(stamps) < MIN_TRIPLES + 2:
        return 0.0
    travelled = np.concatenate([[0.0], np.cumsum(wheel_travel(se2.between(poses[:-1], poses[1:])))])
    speed = (travelled[2:] - travelled[:-2]) / (stamps[2:] - stamps[:-2])
    moving = speed > MIN_SPEED
    if np.count_nonzero(moving) < MIN_TRIPLES:
        return 0.0
    error, factor = deviations_of_triples(stamps, travelled)
    scaled = error[moving] / speed[moving] / factor[moving]
    return NORMAL_SCALE * float(np.median(np.abs(scaled)))


def deviations_of_triples(stamps: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return by how much the second of each three readings is off from the line through the others.

    stamps  (n,) seconds, increasing
    values  (n,) or (n, m) of the readings

    Returns the deviations (n - 2,) or (n - 2, m),

        e = s_1 - (1 - w) s_0 - w s_2,    w = (t_1 - t_0) / (t_2 - t_0),

    and the factor sqrt(1 + w^2 + (1 - w)^2) by which their standard deviation is that of a reading.
    """
    share = (stamps[1:-1] - stamps[:-2]) / (stamps[2:] - stamps[:-2])
    share = share if values.ndim == 1 else share[:, None]
    error = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    return error, np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
