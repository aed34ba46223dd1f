"""Errors of the simulated wheel encoders, and the odometry that results from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..messages import Floats
from ..se2 import wrap
from .raycast import TIME_STEP
from .trajectory import ArcTrajectory


@dataclass(frozen=True, slots=True)
class WheelModel:
    """Parameters of a differential drive and the errors of its odometry.

    rate             odometry readings per second
    wheelbase        metres between the wheels
    slip             white noise of each wheel's travel, metres per square root of a metre: variance slip^2 per metre
    encoder          standard deviation of the white noise of each encoder reading, metres; it does not accumulate
    scale_bias       standard deviation of the relative error of both wheels' size
    difference_bias  standard deviation of the relative difference between the two wheels
    wheelbase_bias   standard deviation of the relative error of the wheelbase

    The biases are drawn once per seed, see `WheelBiases`. If all errors are zero the odometry is exact.
    """

    rate: float = 25.0
    wheelbase: float = 0.35
    slip: float = 0.003
    encoder: float = 0.0002
    scale_bias: float = 0.02
    difference_bias: float = 0.002
    wheelbase_bias: float = 0.02


WHEEL_MODELS = {
    "good": WheelModel(),
    "bad": WheelModel(slip=0.02, encoder=0.0005, scale_bias=0.04, difference_bias=0.004, wheelbase_bias=0.05),
}
"""Wheels by name: well calibrated ones, and worn ones with large drift."""


@dataclass(frozen=True, slots=True)
class WheelBiases:
    """Systematic errors drawn for one seed: factors on each wheel's measured travel and on the wheelbase."""

    left: float
    right: float
    wheelbase: float


def draw_biases(model: WheelModel, random: np.random.Generator) -> WheelBiases:
    """Draw the systematic errors of one run."""
    scale, difference, wheelbase = random.standard_normal(3).tolist()
    both = 1.0 + model.scale_bias * scale
    half = model.difference_bias * difference / 2
    return WheelBiases(both - half, both + half, 1.0 + model.wheelbase_bias * wheelbase)


def simulate_odometry(
    trajectory: ArcTrajectory, times: Floats, model: WheelModel, biases: WheelBiases, random: np.random.Generator
) -> Floats:
    """Return odometry poses (n, 3) at times (n,), starting from [0, 0, 0].

    Each wheel's travel between two readings is measured as the true travel times its bias, plus slip; encoder noise is
    added to the readings. The poses are dead reckoning along arcs with the biased wheelbase.
    """
    true_distance, true_turn = _travel(trajectory, times)
    offset = np.array([-0.5, 0.5]) * model.wheelbase
    wheels = true_distance[:, None] + true_turn[:, None] * offset  # (n - 1, 2) left, right
    slip = model.slip * np.sqrt(np.abs(wheels)) * random.standard_normal(wheels.shape)
    wheels = wheels * [biases.left, biases.right] + slip
    readings = np.vstack([np.zeros(2), np.cumsum(wheels, axis=0)])
    readings += model.encoder * random.standard_normal(readings.shape)
    left, right = np.diff(readings, axis=0).T
    turn = (right - left) / (model.wheelbase * biases.wheelbase)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    chord = (left + right) / 2 * np.sinc(turn / (2 * np.pi))  # numpy's sinc(x) is sin(pi x) / (pi x)
    direction = heading[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(direction))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(direction))])
    return np.column_stack([x, y, wrap(heading)])


def _travel(trajectory: ArcTrajectory, times: Floats) -> tuple[Floats, Floats]:
    """Return the distance (metres) and the turn (radians) between successive times (n,), each (n - 1,)."""
    edges = np.arange(len(trajectory.twists) + 1) * TIME_STEP
    total = np.vstack([np.zeros(2), np.cumsum(trajectory.twists * TIME_STEP, axis=0)])
    distance, turn = (np.interp(times, edges, total[:, i]) for i in (0, 1))
    return np.diff(distance), np.diff(turn)
