"""Odometry without jumps that no robot can make.

A base that starts again counts from zero. What the robot did meanwhile is not known: it may have stood, or have been
carried. So no motion is taken, as in both cases the wheels did not turn; if scans show another place then, it was
carried. A damaged reading may be anywhere, and the next one is where it would be without. So may be a counter that
overflows. Tracking, which compares odometry with the scans, handles slips. But along a bare corridor scans contradict
no jump, poses far from odometry are not searched, and a motion of kilometres exceeds what a map can represent.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry

from ..geometry.surroundings import BUILDING_SIZE
from .history import wheel_travel
from .measurement_clock import MeasurementClock

# Metres from which a motion between two readings may be a jump: tracking searches poses up to here, and stamps that are
# wrong by half a second make such motions fast. Origin: chosen, for speed: a sparse log has
# a scan a metre.
MIN_JUMP = 1.5
# Metres per second from which it is a jump. Origin: chosen, more than any robot with a two-dimensional lidar drives.
MIN_JUMP_SPEED = 30.0
# Metres from which a motion is a jump however long it took: it says nothing about the robot then. Origin:
# definition.
MAX_UNSEEN = BUILDING_SIZE
# Metres and radians below which a coordinate is zero. Origin: numerical, of poses that are composed of transforms.
ZERO = 1e-9
# Seconds since the last reading of a run for which another one is its continuation. Origin: chosen, time to restart a
# program; not measured.
MAX_BREAK = 60.0
# Metres of wheel travel from which a motion to zero is a new start of the base: the three coordinates of a robot that
# drives are never all zero. Origin: chosen, above the jitter of a robot that stands where its base has started.
MIN_RESTART = 0.1

JUMPED = "odometry jumps farther than a robot can drive, and goes on from where it was"
RESTARTED = "odometry starts again at zero, and goes on from where it was"


class ContinuousOdometry:
    """Odometry without its jumps: after a jump it goes on from the reading before, as if the robot had stood meanwhile.

    jump  what the last reading came after, as text, if that was a jump
    """

    def __init__(self, earlier: Odometry | None = None) -> None:
        """`earlier` is the last reading of the run that is continued; a base that was started again goes on from it."""
        self.jump: str | None = None
        self._earlier = earlier
        self._clock = MeasurementClock()  # of the readings
        self._last: _Reading | None = None
        self._before_jump: _Reading | None = None  # while no reading since the jump differs from the first one

    def continued(self, reading: Odometry) -> Odometry:
        """Return the next reading with its pose in the frame of the first one."""
        last, before = self._last, self._before_jump
        self._clock.interval(reading.stamp)
        if last is None:
            self._last = self._first(reading)
            return self._last.used
        period = self._clock.period
        self.jump = _jump(last.read, reading, period)
        if before is not None and not np.array_equal(reading.pose, last.read.pose):
            self._before_jump = None
        if before is not None and _goes_on_from(before.read, last.read, reading, period):
            self._last = before.followed_by(reading)  # what was read since then was damaged
        elif self.jump is not None:
            self._last, self._before_jump = _Reading(reading, replace(reading, pose=last.used.pose)), last
        else:
            self._last = last.followed_by(reading)
        return self._last.used

    def _first(self, reading: Odometry) -> _Reading:
        """Return the first reading; that of a base which was started again is at the last pose of the earlier run."""
        earlier = self._earlier
        if earlier is None or reading.stamp > earlier.stamp + MAX_BREAK or not _starts_again(earlier, reading):
            return _Reading(reading, reading)
        self.jump = RESTARTED
        return _Reading(reading, replace(reading, pose=earlier.pose))


@immutable
class _Reading:
    """A reading as it was read, and as it is used: in the frame of the first one."""

    read: Odometry
    used: Odometry

    def followed_by(self, reading: Odometry) -> _Reading:
        """Return the next reading, which goes on from this one."""
        if self.used is self.read:
            return _Reading(reading, reading)
        return _Reading(
            reading, replace(reading, pose=se2.compose(self.used.pose, se2.between(self.read.pose, reading.pose)))
        )


def _goes_on_from(before: Odometry, damaged: Odometry, reading: Odometry, period: float) -> bool:
    """Return True if a reading goes on from the one before a jump, and not from the one after it; see `_jump`."""
    return _jump(before, reading, period) is None and _travel(before, reading) < _travel(damaged, reading)


def _travel(first: Odometry, second: Odometry) -> float:
    """Return the metres that the wheels roll between two readings."""
    return float(wheel_travel(se2.between(first.pose, second.pose)))


def _jump(last: Odometry, reading: Odometry, period: float) -> str | None:
    """Return why a robot can hardly have moved from a reading to the next one, as text; None if it can.

    period  seconds between readings, which their stamps may make shorter
    """
    x, y, _ = reading.pose.tolist()
    distance = math.hypot(x - last.pose[0], y - last.pose[1])
    seconds = max(reading.stamp - last.stamp, period)
    if distance > MIN_JUMP and distance > min(MAX_UNSEEN, MIN_JUMP_SPEED * seconds):
        return JUMPED
    return RESTARTED if _starts_again(last, reading) else None


def _starts_again(last: Odometry, reading: Odometry) -> bool:
    """Return True if a reading is the first one of a base that counts from zero again."""
    is_zero = all(abs(coordinate) < ZERO for coordinate in reading.pose.tolist())
    return is_zero and _travel(last, reading) > MIN_RESTART
