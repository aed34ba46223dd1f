"""What encoders count and gyros feel while the robot drives."""

from __future__ import annotations

import math

import numpy as np

from ..bases.kinematics import DifferentialDrive, Noise
from ..se2 import wrap
from ..simulation.driving import Drive, draw_biases
from .motion import Motion


class Encoders:
    """Counts of both wheels, wrong as `Drive` says: the base's true measures differ a little from its stated ones.

    wheels  the stated measures
    drive   slip, noise and biases, of which one draw is made; its rate and wheelbase are the protocol's here
    """

    def __init__(self, motion: Motion, wheels: DifferentialDrive, drive: Drive, random: np.random.Generator) -> None:
        self._motion, self._wheels, self._drive, self._random = motion, wheels, drive, random
        self.biases = draw_biases(drive, random)
        self._rolled = np.zeros(2)  # left, right, metres as the counts tell them
        self._zero = np.zeros(2)
        self._last = motion.driven(0.0)

    def read(self, time: float) -> tuple[int, int]:
        """Left and right count at a time not before the last; not wrapped."""
        driven = self._motion.driven(time)
        way, turn = driven[0] - self._last[0], driven[1] - self._last[1]
        self._last = driven
        # Dead reckoning that divides by the stated track finds as much too little as the true one is shorter.
        half = turn * self._wheels.track / self.biases.wheelbase / 2
        rolled = np.array([way - half, way + half])
        slip = self._drive.slip * np.sqrt(np.abs(rolled)) * self._random.standard_normal(2)
        self._rolled += rolled * [self.biases.left, self.biases.right] + slip
        told = self._rolled - self._zero + self._drive.encoder * self._random.standard_normal(2)
        return math.floor(told[0] / self._wheels.left), math.floor(told[1] / self._wheels.right)

    def reset(self, time: float) -> None:
        """Count from zero on, from a time not before the last."""
        self.read(time)
        self._zero = self._rolled.copy()


class Gyro:
    """The heading that a gyro tells, from zero on; its error is a random walk."""

    def __init__(self, motion: Motion, random: np.random.Generator, variance: float = Noise().gyro) -> None:
        self._motion, self._random, self._variance = motion, random, variance
        self._error, self._last = 0.0, 0.0

    def read(self, time: float) -> float:
        """Radians in [-pi, pi) at a time not before the last."""
        self._error += math.sqrt(self._variance * max(time - self._last, 0.0)) * self._random.standard_normal()
        self._last = time
        return float(wrap(self._motion.driven(time)[1] + self._error))
