"""Readings of wheels in, poses out: encoders that wrap or start again, readings that cannot be, gyros."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..messages import Floats, Odometry
from .interface import WheelReading, signed
from .kinematics import DifferentialDrive, Motion, Noise, advance, gyro_motion, wheel_motion

HASTE = 1.5
"""Times its top speed that a wheel may turn: what a base states is what it drives, downhill it can be faster."""
SLACK = 0.05
"""Seconds by which two stamps may be nearer to each other than the readings were."""


@dataclass(slots=True)
class OdometerCounters:
    """What the odometer met.

    readings    taken up
    resets      times when the counts went on from elsewhere, as after a restart of the base
    jumps       single readings that no wheel could have turned to; left out, and the next reading makes up for them
    gaps        pauses so long that the encoders may have wrapped unseen
    gyro_jumps  headings that no base could have turned to; the wheels' turn was taken instead
    disordered  readings not later than the one before; left out
    """

    readings: int = 0
    resets: int = 0
    jumps: int = 0
    gaps: int = 0
    gyro_jumps: int = 0
    disordered: int = 0


class Odometer:
    """Dead reckoning from [0, 0, 0], where the first reading is.

    pose        [x, y, heading] in the odometry's frame
    covariance  (3, 3) of it, zero at the start

    What was driven across a reset or a gap is unknown. The pose stays as it was, and the covariance grows as if any way
    at the top speed had been equally likely.
    """

    def __init__(self, wheels: DifferentialDrive, noise: Noise | None = None) -> None:
        self.wheels, self.noise = wheels, noise or Noise()
        self.pose: Floats = np.zeros(3)
        self.covariance: Floats = np.zeros((3, 3))
        self.counters = OdometerCounters()
        self._last: tuple[WheelReading, float] | None = None
        self._suspect: tuple[WheelReading, float] | None = None

    def add(self, reading: WheelReading, stamp: float) -> Odometry | None:
        """Take up a reading that was measured at a stamp (seconds); None where it does not count, or not yet."""
        if self._last is None:
            return self._take(reading, stamp)
        if stamp <= (self._suspect or self._last)[1]:
            self.counters.disordered += 1
            return None
        if self._may_have_wrapped(stamp - self._last[1]):
            self.counters.gaps += 1
            return self._begin_again(reading, stamp)
        if self._possible(self._last, reading, stamp):
            self._forget_suspect()
            return self._step(self._last, reading, stamp)
        if self._suspect is not None and self._possible(self._suspect, reading, stamp):
            suspect, self._suspect = self._suspect, None
            self.counters.resets += 1
            self._begin_again(*suspect)
            return self._step(suspect, reading, stamp)
        self._forget_suspect()
        self._suspect = (reading, stamp)
        return None

    def _take(self, reading: WheelReading, stamp: float) -> Odometry:
        self._last = (reading, stamp)
        self.counters.readings += 1
        return Odometry(stamp, self.pose.copy())

    def _step(self, last: tuple[WheelReading, float], reading: WheelReading, stamp: float) -> Odometry:
        motion = self._motion(last[0], reading, stamp - last[1])
        self.pose, self.covariance = advance(self.pose, self.covariance, motion)
        return self._take(reading, stamp)

    def _begin_again(self, reading: WheelReading, stamp: float) -> Odometry:
        """Count from this reading on; the way to it is unknown, uniformly within what the wheels can do."""
        assert self._last is not None
        self._forget_suspect()
        way = self.wheels.top_speed * (stamp - self._last[1])
        turn = min(2 * way / self.wheels.track, math.pi)
        self.covariance = self.covariance + np.diag([way**2, way**2, turn**2]) / 3
        return self._take(reading, stamp)

    def _forget_suspect(self) -> None:
        self.counters.jumps += self._suspect is not None
        self._suspect = None

    def _travel(self, last: WheelReading, reading: WheelReading) -> tuple[float, float]:
        """Metres that the left and the right wheel rolled, across a wrap of the counters."""
        wheels = self.wheels
        left, right = signed(reading.left - last.left, wheels.bits), signed(reading.right - last.right, wheels.bits)
        return left * wheels.left, right * wheels.right

    def _farthest(self, duration: float) -> float:
        """Metres that a wheel can have rolled."""
        return HASTE * self.wheels.top_speed * (duration + SLACK)

    def _may_have_wrapped(self, duration: float) -> bool:
        finest = min(abs(self.wheels.left), abs(self.wheels.right))
        return self._farthest(duration) >= finest * (1 << (self.wheels.bits - 1))

    def _possible(self, last: tuple[WheelReading, float], reading: WheelReading, stamp: float) -> bool:
        left, right = self._travel(last[0], reading)
        return max(abs(left), abs(right)) <= self._farthest(stamp - last[1])

    def _motion(self, last: WheelReading, reading: WheelReading, duration: float) -> Motion:
        left, right = self._travel(last, reading)
        by_wheels = wheel_motion(left, right, self.wheels.track, self.noise)
        if last.heading is None or reading.heading is None:
            return by_wheels
        turn = reading.heading - last.heading
        turn += 2 * math.pi * round((by_wheels.turn - turn) / (2 * math.pi))
        if abs(turn) > 2 * self._farthest(duration) / self.wheels.track:
            self.counters.gyro_jumps += 1
            return by_wheels
        return gyro_motion(left, right, turn, duration, self.noise)
