"""Dead reckoning of two wheels on one axle, along exact arcs, with covariance.

While both wheels turn steadily the base drives an arc of length ds and angle dth,

    ds = (dr + dl) / 2,   dth = (dr - dl) / track,

whose chord is c = ds sinc(dth / 2) long, sinc(x) = sin(x) / x, and points to the middle of the old and the new heading:

    x' = x + c cos(th + dth / 2),   y' = y + c sin(th + dth / 2),   th' = th + dth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..messages import Floats
from ..se2 import Pose, wrap


@dataclass(frozen=True, slots=True)
class DifferentialDrive:
    """The measures of a base with two driven wheels.

    left, right  metres that each wheel rolls per encoder count; negative where an encoder counts backwards
    track        metres between the points where the wheels touch the ground
    bits         of the encoders' counters, which wrap
    top_speed    metres per second of a wheel
    """

    left: float
    right: float
    track: float
    bits: int
    top_speed: float

    def wheel_speeds(self, speed: float, turn_rate: float) -> tuple[float, float]:
        """The left and the right wheel's speed (m/s) that drive at a speed (m/s) and a turn rate (rad/s).

        Where a wheel would have to be faster than it can, both are slowed down alike: the arc remains.
        """
        half = turn_rate * self.track / 2
        left, right = speed - half, speed + half
        slower = min(1.0, self.top_speed / max(abs(left), abs(right), self.top_speed))
        return left * slower, right * slower


@dataclass(frozen=True, slots=True)
class Noise:
    """How wrong wheels and gyro are; what is systematic is calibrated, not covered by this.

    wheel  variance of a wheel's travel per metre it rolls, m^2 per m: slip and roughness of the ground
    gyro   variance of a gyro's heading per second, rad^2 per s: a MEMS gyro's noise of 0.02 degrees per root second
    """

    wheel: float = 1e-5
    gyro: float = 1.2e-7


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """An arc: its length (metres), its angle (radians) and the covariance (2, 2) of both."""

    distance: float
    turn: float
    covariance: Floats


def wheel_motion(left: float, right: float, track: float, noise: Noise) -> Motion:
    """The arc that the wheels' travel (metres) tells, their errors independent of each other."""
    variance_left, variance_right = noise.wheel * abs(left), noise.wheel * abs(right)
    both, difference = variance_right + variance_left, variance_right - variance_left
    covariance = np.array([[both / 4, difference / (2 * track)], [difference / (2 * track), both / track**2]])
    return Motion((right + left) / 2, (right - left) / track, covariance)


def gyro_motion(left: float, right: float, turn: float, duration: float, noise: Noise) -> Motion:
    """The arc whose length the wheels' travel (metres) tells, and whose angle (radians) a gyro does, in seconds."""
    variance = noise.wheel * (abs(left) + abs(right)) / 4
    return Motion((right + left) / 2, turn, np.diag([variance, noise.gyro * duration]))


def advance(pose: Pose, covariance: Floats, motion: Motion) -> tuple[Pose, Floats]:
    """Drive an arc: the pose [x, y, heading] and its covariance (3, 3) at its end.

    P' = F P F' + G Q G', with F the derivative of the new pose by the old one and G that by the arc's length and angle.
    """
    ds, half = motion.distance, motion.turn / 2
    chord, chord_slope = _sinc(half), _sinc_slope(half)
    c, s = math.cos(pose[2] + half), math.sin(pose[2] + half)
    dx, dy = ds * chord * c, ds * chord * s
    new = np.array([pose[0] + dx, pose[1] + dy, float(wrap(pose[2] + motion.turn))])
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    G = np.array(
        [
            [chord * c, ds * (chord_slope * c - chord * s) / 2],
            [chord * s, ds * (chord_slope * s + chord * c) / 2],
            [0.0, 1.0],
        ]
    )
    grown = F @ covariance @ F.T + G @ motion.covariance @ G.T
    return new, (grown + grown.T) / 2


SMALL = 1e-4
"""Radians below which series stand in for quotients; the first neglected terms are below 1e-9 of the value."""


def _sinc(x: float) -> float:
    return math.sin(x) / x if abs(x) > SMALL else 1.0 - x * x / 6


def _sinc_slope(x: float) -> float:
    return (math.cos(x) - math.sin(x) / x) / x if abs(x) > SMALL else -x / 3
