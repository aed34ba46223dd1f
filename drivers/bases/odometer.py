"""Odometry from wheel readings: handles encoders that wrap or restart, impossible readings, and gyros."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..messages import Floats, Odometry
from .interface import WheelReading, to_signed
from .kinematics import ArcMotion, DifferentialDrive, OdometryNoise, advance, motion_from_gyro, motion_from_wheels

MAX_SPEED_RATIO = 1.5
"""Factor on the stated top speed of a wheel: downhill it can be faster."""
STAMP_TOLERANCE = 0.05
"""Seconds by which the interval of two stamps may be shorter than that of the readings."""

BOOT_TIME = 0.3
"""Seconds without readings from which on a base may have restarted: boards start again in half a second to three."""
MIN_RESTART_TRAVEL = 0.1
"""Metres from zero from which counts near zero after such a pause show a restart."""
NEAR_ZERO = 0.1
"""Share of that travel up to which counts are near zero: the robot may have driven since the restart."""


@dataclass(slots=True)
class OdometerCounters:
    """Counters of the odometer.

    readings    accepted readings
    resets      restarts of the counts, at zero or at other values, as after a restart of the base
    jumps       single readings that no wheel can have reached; omitted, the next reading covers their motion
    gaps        pauses in which the encoders may have wrapped
    gyro_jumps  headings that the base cannot have reached; the wheels' turn was used instead
    disordered  readings not later than the previous one; omitted
    """

    readings: int = 0
    resets: int = 0
    jumps: int = 0
    gaps: int = 0
    gyro_jumps: int = 0
    disordered: int = 0


class Odometer:
    """Dead reckoning from [0, 0, 0] at the first reading.

    pose        [x, y, heading] in the odometry's frame
    covariance  (3, 3) of the pose, zero at the start

    The motion during a reset or a gap is unknown: the pose is kept, and the covariance grows by that of a uniform
    distribution of the travel up to the top speed.
    """

    def __init__(self, wheels: DifferentialDrive) -> None:
        self.wheels, self.noise = wheels, OdometryNoise()
        self.pose: Floats = np.zeros(3)
        self.covariance: Floats = np.zeros((3, 3))
        self.counters = OdometerCounters()
        self._last: tuple[WheelReading, float] | None = None
        self._suspect: tuple[WheelReading, float] | None = None

    def add(self, reading: WheelReading, stamp: float) -> Odometry | None:
        """Add a reading measured at a stamp (seconds) and return the odometry; None if it is omitted or suspect."""
        if self._last is None:
            return self._accept(reading, stamp)
        if stamp <= (self._suspect or self._last)[1]:
            self.counters.disordered += 1
            return None
        if self._may_have_wrapped(stamp - self._last[1]):
            self.counters.gaps += 1
            return self._restart(reading, stamp)
        if self._counts_from_zero(reading, stamp):
            self.counters.resets += 1
            return self._restart(reading, stamp)
        if self._is_possible(self._last, reading, stamp):
            self._drop_suspect()
            return self._step(self._last, reading, stamp)
        if self._suspect is not None and self._is_possible(self._suspect, reading, stamp):
            suspect, self._suspect = self._suspect, None
            self.counters.resets += 1
            self._restart(*suspect)
            return self._step(suspect, reading, stamp)
        self._drop_suspect()
        self._suspect = (reading, stamp)
        return None

    def _accept(self, reading: WheelReading, stamp: float) -> Odometry:
        self._last = (reading, stamp)
        self.counters.readings += 1
        return Odometry(stamp, self.pose.copy())

    def _step(self, last: tuple[WheelReading, float], reading: WheelReading, stamp: float) -> Odometry:
        motion = self._arc(last[0], reading, stamp - last[1])
        self.pose, self.covariance = advance(self.pose, self.covariance, motion)
        return self._accept(reading, stamp)

    def _restart(self, reading: WheelReading, stamp: float) -> Odometry:
        """Continue from this reading; the travel to it is unknown, uniformly distributed up to the top speed."""
        assert self._last is not None
        self._drop_suspect()
        travel = self.wheels.top_speed * (stamp - self._last[1])
        turn = min(2 * travel / self.wheels.track, math.pi)
        self.covariance = self.covariance + np.diag([travel**2, travel**2, turn**2]) / 3
        return self._accept(reading, stamp)

    def _drop_suspect(self) -> None:
        self.counters.jumps += self._suspect is not None
        self._suspect = None

    def _travel(self, last: WheelReading, reading: WheelReading) -> tuple[float, float]:
        """Return the travel (metres) of the left and the right wheel, with wraps of the counters resolved."""
        wheels = self.wheels
        left, right = (
            to_signed(reading.left - last.left, wheels.bits),
            to_signed(reading.right - last.right, wheels.bits),
        )
        return left * wheels.left, right * wheels.right

    def _max_travel(self, duration: float) -> float:
        """Return the largest possible travel of a wheel, metres."""
        return MAX_SPEED_RATIO * self.wheels.top_speed * (duration + STAMP_TOLERANCE)

    def _may_have_wrapped(self, duration: float) -> bool:
        finest = min(abs(self.wheels.left), abs(self.wheels.right))
        return self._max_travel(duration) >= finest * (1 << (self.wheels.bits - 1))

    def _counts_from_zero(self, reading: WheelReading, stamp: float) -> bool:
        """Return True if a base that was silent has restarted, and counts from zero again.

        Early in a drive the speed does not exclude that the robot has driven back to its start meanwhile.
        """
        assert self._last is not None
        zero = WheelReading(0, 0)
        before, now = (max(map(abs, self._travel(zero, one))) for one in (self._last[0], reading))
        return stamp - self._last[1] >= BOOT_TIME and before >= MIN_RESTART_TRAVEL and now <= NEAR_ZERO * before

    def _is_possible(self, last: tuple[WheelReading, float], reading: WheelReading, stamp: float) -> bool:
        left, right = self._travel(last[0], reading)
        return max(abs(left), abs(right)) <= self._max_travel(stamp - last[1])

    def _arc(self, last: WheelReading, reading: WheelReading, duration: float) -> ArcMotion:
        left, right = self._travel(last, reading)
        by_wheels = motion_from_wheels(left, right, self.wheels.track, self.noise)
        if last.heading is None or reading.heading is None:
            return by_wheels
        turn = reading.heading - last.heading
        turn += 2 * math.pi * round((by_wheels.turn - turn) / (2 * math.pi))
        if abs(turn) > 2 * self._max_travel(duration) / self.wheels.track:
            self.counters.gyro_jumps += 1
            return by_wheels
        return motion_from_gyro(left, right, turn, duration, self.noise)
