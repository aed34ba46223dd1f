"""Odometry readings of a run, and the pose of the base between them."""

from __future__ import annotations

import bisect
from array import array

import numpy as np

from drivers import se2
from drivers.messages import Odometry

from ..geometry.segments import Floats

# Metres of travel that one radian of turning counts for: about half the distance between a robot's wheels, and a bit.
# Origin: geometry, wheels of small robots are 0.2 to 0.4 m apart.
TRAVEL_PER_RADIAN = 0.25


class OdometryHistory:
    """All odometry readings of a run, in time order."""

    def __init__(self) -> None:
        # Arrays, not lists of objects, which are six times as large: a robot drives for days.
        self._stamps, self._poses = array("d"), array("d")  # of the poses, three numbers each

    @classmethod
    def from_arrays(cls, stamps: Floats, poses: Floats) -> OdometryHistory:
        """Build a history from stamps (n,) in increasing order and poses (n, 3)."""
        history = cls()
        history._stamps, history._poses = array("d", stamps), array("d", poses.ravel())
        return history

    def copy(self) -> OdometryHistory:
        """Return a copy that later readings do not change."""
        other = OdometryHistory()
        other._stamps, other._poses = self._stamps[:], self._poses[:]
        return other

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, reading: Odometry) -> None:
        """Append a reading; one that is not later than the last replaces its pose."""
        if self._stamps and reading.stamp <= self._stamps[-1]:
            self._poses[-3:] = array("d", reading.pose)
            return
        self._stamps.append(reading.stamp)
        self._poses.extend(reading.pose)

    @property
    def latest(self) -> float:
        """Stamp of the last reading, -inf without one."""
        return self._stamps[-1] if self._stamps else -np.inf

    @property
    def stamps(self) -> Floats:
        """(n,) seconds."""
        return np.array(self._stamps)

    @property
    def poses(self) -> Floats:
        """(n, 3) in the odometry's frame."""
        return np.array(self._poses).reshape(-1, 3)

    @property
    def travelled(self) -> Floats:
        """(n,) metres of wheel travel up to each reading."""
        poses = self.poses
        return np.concatenate([[0.0], np.cumsum(wheel_travel(se2.between(poses[:-1], poses[1:])))])

    def at(self, stamp: float) -> se2.Pose:
        """Return the pose at a stamp, interpolated linearly in SE(2); constant before the first and after the last."""
        after = bisect.bisect_left(self._stamps, stamp)
        if after == len(self._stamps):
            return self._pose(after - 1)
        if after == 0 or self._stamps[after] == stamp:
            return self._pose(after)
        before = self._pose(after - 1)
        part = (stamp - self._stamps[after - 1]) / (self._stamps[after] - self._stamps[after - 1])
        return se2.compose(before, part * se2.between(before, self._pose(after)))

    def at_each(self, stamps: Floats) -> Floats:
        """Return (n, 3) the poses at several stamps."""
        stamps = np.asarray(stamps, dtype=np.float64)
        if not len(stamps):
            return np.zeros((0, 3))
        readings = self.stamps
        after = np.minimum(np.searchsorted(readings, stamps), len(readings) - 1)
        result = self.poses[after]
        for row in np.flatnonzero((readings[after] > stamps) & (after > 0)).tolist():
            result[row] = self.at(float(stamps[row]))
        return result

    def _pose(self, reading: int) -> se2.Pose:
        return np.array(self._poses[3 * reading : 3 * reading + 3])


def wheel_travel(motion: se2.Pose) -> Floats:
    """Return (...,) the metres that the wheels roll in motions (..., 3): the length, plus a share for turning."""
    return np.asarray(np.hypot(motion[..., 0], motion[..., 1]) + TRAVEL_PER_RADIAN * np.abs(motion[..., 2]))
