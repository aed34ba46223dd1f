"""Encoder counts and gyro headings of the driving robot."""

from __future__ import annotations

import math

import numpy as np

from ..bases.kinematics import DifferentialDrive, OdometryNoise
from ..se2 import wrap
from ..simulation.wheel_model import WheelModel, draw_biases
from .robot_motion import RobotMotion


class Encoders:
    """Counts of both wheels, with the errors of `WheelModel`: the true wheel geometry differs a little from the stated
    one.

    wheels  the stated geometry
    drive   slip, noise and biases, drawn once; its rate and wheelbase are the protocol's here
    """

    def __init__(
        self, motion: RobotMotion, wheels: DifferentialDrive, drive: WheelModel, random: np.random.Generator
    ) -> None:
        self._motion, self._wheels, self._drive, self._random = motion, wheels, drive, random
        self.biases = draw_biases(drive, random)
        self._rolled = np.zeros(2)  # left, right, metres as counted
        self._zero = np.zeros(2)
        self._last = motion.travelled(0.0)

    def read(self, time: float) -> tuple[int, int]:
        """Return the left and right count at a time not before the last one; not wrapped."""
        travelled = self._motion.travelled(time)
        distance, turn = travelled[0] - self._last[0], travelled[1] - self._last[1]
        self._last = travelled
        # Dead reckoning with the stated track underestimates turns in the ratio by which the true track is shorter.
        half = turn * self._wheels.track / self.biases.wheelbase / 2
        rolled = np.array([distance - half, distance + half])
        slip = self._drive.slip * np.sqrt(np.abs(rolled)) * self._random.standard_normal(2)
        self._rolled += rolled * [self.biases.left, self.biases.right] + slip
        measured = self._rolled - self._zero + self._drive.encoder * self._random.standard_normal(2)
        return math.floor(measured[0] / self._wheels.left), math.floor(measured[1] / self._wheels.right)

    def reset(self, time: float) -> None:
        """Reset the counts to zero at a time not before the last one."""
        self.read(time)
        self._zero = self._rolled.copy()


class Gyro:
    """A gyro's heading, starting at zero; its error is a random walk."""

    def __init__(self, motion: RobotMotion, random: np.random.Generator) -> None:
        self._motion, self._random, self._variance = motion, random, OdometryNoise().gyro
        self._error, self._last = 0.0, 0.0

    def read(self, time: float) -> float:
        """Return radians in [-pi, pi) at a time not before the last one."""
        self._error += math.sqrt(self._variance * max(time - self._last, 0.0)) * self._random.standard_normal()
        self._last = time
        return float(wrap(self._motion.travelled(time)[1] + self._error))
