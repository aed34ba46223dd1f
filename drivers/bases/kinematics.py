"""Dead reckoning of a differential drive along exact arcs, with covariance.

If both wheels turn at constant speed, the base drives an arc of length ds and angle dth,

    ds = (dr + dl) / 2,   dth = (dr - dl) / track,

whose chord has the length c = ds sinc(dth / 2), sinc(x) = sin(x) / x, and the mean of the old and new heading:

    x' = x + c cos(th + dth / 2),   y' = y + c sin(th + dth / 2),   th' = th + dth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..immutable import immutable
from ..messages import Floats
from ..se2 import Pose, wrap


@dataclass(frozen=True, slots=True)
class DifferentialDrive:
    """Dimensions of a base with two driven wheels.

    left, right  metres that each wheel rolls per encoder count; negative if an encoder counts backwards
    track        metres between the wheels' contact points
    bits         size of the encoders' counters, which wrap
    top_speed    maximum speed of a wheel, m/s
    """

    left: float
    right: float
    track: float
    bits: int
    top_speed: float

    def wheel_speeds(self, speed: float, turn_rate: float) -> tuple[float, float]:
        """Return the left and right wheel's speed (m/s) for a speed (m/s) and a turn rate (rad/s).

        If a wheel would exceed its top speed, both are reduced by the same factor, which keeps the arc.
        """
        half = turn_rate * self.track / 2
        left, right = speed - half, speed + half
        factor = min(1.0, self.top_speed / max(abs(left), abs(right), self.top_speed))
        return left * factor, right * factor


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Random errors of wheels and gyro. Systematic errors are removed by calibration.

    wheel  variance of a wheel's travel per metre it rolls, m^2 per m: slip and roughness of the ground
    gyro   variance of a gyro's heading per second, rad^2 per s: 0.02 degrees per root second for a MEMS gyro
    """

    wheel: float = 1e-5
    gyro: float = 1.2e-7


@immutable
class ArcMotion:
    """Arc: its length (metres), its angle (radians) and the covariance (2, 2) of both."""

    distance: float
    turn: float
    covariance: Floats


def motion_from_wheels(left: float, right: float, track: float, noise: OdometryNoise) -> ArcMotion:
    """Return the arc from the travel of the left and the right wheel, with independent errors of the wheels.

    left, right, track  metres; the track is the distance between the wheels
    """
    variance_left, variance_right = noise.wheel * abs(left), noise.wheel * abs(right)
    both, difference = variance_right + variance_left, variance_right - variance_left
    covariance = np.array([[both / 4, difference / (2 * track)], [difference / (2 * track), both / track**2]])
    return ArcMotion((right + left) / 2, (right - left) / track, covariance)


def motion_from_gyro(left: float, right: float, turn: float, duration: float, noise: OdometryNoise) -> ArcMotion:
    """Return the arc with its length from the wheels and its angle from a gyro.

    left, right  travel of the wheels, metres
    turn         angle by the gyro, radians
    duration     of the arc, seconds; the gyro's variance is proportional to it
    """
    variance = noise.wheel * (abs(left) + abs(right)) / 4
    return ArcMotion((right + left) / 2, turn, np.diag([variance, noise.gyro * duration]))


def advance(pose: Pose, covariance: Floats, motion: ArcMotion) -> tuple[Pose, Floats]:
    """Return the pose [x, y, heading] and its covariance (3, 3) at the end of an arc.

    P' = F P F^T + G Q G^T with the Jacobians F by the old pose and G by the arc's length and angle.
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
    propagated = F @ covariance @ F.T + G @ motion.covariance @ G.T
    return new, (propagated + propagated.T) / 2


SERIES_LIMIT = 1e-4
"""Radians below which Taylor series replace quotients; the neglected terms are below 1e-9 of the value."""


def _sinc(x: float) -> float:
    return math.sin(x) / x if abs(x) > SERIES_LIMIT else 1.0 - x * x / 6


def _sinc_slope(x: float) -> float:
    return (math.cos(x) - math.sin(x) / x) / x if abs(x) > SERIES_LIMIT else -x / 3
