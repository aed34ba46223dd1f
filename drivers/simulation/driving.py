"""How the simulated robot drives: a path through way points, and what its wheels make of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from ..messages import Floats
from ..se2 import wrap
from .raycast import STEP, poses_at

REACHED = 0.25
"""Metres. The robot heads for the next way point when it is so near to one, which rounds its corners."""
ARRIVED = 0.05
"""Metres. The same for the last way point."""
TURN_RATE = 1.0
"""Radians a second, at most."""
STEERING = 2.5
"""Turn rate per radian of heading error, 1/s."""
ACCELERATION, TURN_ACCELERATION = 0.6, 4.0
"""m/s^2 and rad/s^2, at most."""
STANDSTILL = 1.0
"""Seconds that the robot stands before it starts and after it has arrived."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A differential drive and what is wrong with it.

    rate             odometry readings a second
    wheelbase        metres between the wheels
    slip             white noise of each wheel's travel, metres per root metre: its variance grows with the way
    encoder          white noise of each reading of a wheel's way, metres: it does not add up
    scale_bias       standard deviation of the relative error of both wheels' size
    difference_bias  standard deviation of the relative difference between the two wheels
    wheelbase_bias   standard deviation of the relative error of the wheelbase

    The biases are drawn once for each seed; see `Biases`. Zeros make a perfect drive.
    """

    rate: float = 25.0
    wheelbase: float = 0.35
    slip: float = 0.003
    encoder: float = 0.0002
    scale_bias: float = 0.02
    difference_bias: float = 0.002
    wheelbase_bias: float = 0.02


@dataclass(frozen=True, slots=True)
class Biases:
    """What was drawn for one seed: factors on each wheel's measured travel and on the wheelbase."""

    left: float
    right: float
    wheelbase: float


def draw_biases(drive: Drive, random: np.random.Generator) -> Biases:
    """The wheels' errors for one run."""
    scale, difference, wheelbase = random.standard_normal(3).tolist()
    both = 1.0 + drive.scale_bias * scale
    half = drive.difference_bias * difference / 2
    return Biases(both - half, both + half, 1.0 + drive.wheelbase_bias * wheelbase)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """The true motion: poses (k, 3) where steps of STEP seconds begin, and twists (k, 2), speed and turn
    rate, during them.
    """

    poses: Floats
    twists: Floats

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self.poses) * STEP

    def at(self, times: Floats) -> Floats:
        """Poses (n, 3), headings in [-pi, pi), at times (n,) in seconds."""
        poses = poses_at(times, self.poses, self.twists)
        poses[:, 2] = wrap(poses[:, 2])
        return poses


class Steering:
    """Heads for one way point (k, 2) after the other, in steps of STEP seconds, having stood for STANDSTILL.

    speed    metres a second
    endless  round again where the path ends where it begins, back and forth where it does not; else it ends at the last
    """

    def __init__(self, points: Floats, speed: float, endless: bool) -> None:
        self._speed = speed
        self._ahead = _way_points(points, endless)
        self._target = next(self._ahead)
        self._following = next(self._ahead, None)
        self._standing = round(STANDSTILL / STEP)
        self._v = self._w = 0.0

    def step(self, x: float, y: float, heading: float) -> tuple[float, float] | None:
        """Speed and turn rate for the next step from a pose; None at the last way point."""
        gap = self._gap(x, y)
        if self._following is None and gap < ARRIVED:
            return None
        if self._following is not None and gap < REACHED:
            self._target, self._following = self._following, next(self._ahead, None)
            gap = self._gap(x, y)
        if self._standing:
            self._standing -= 1
        else:
            error = math.atan2(self._target[1] - y, self._target[0] - x) - heading
            self._v, self._w = _steer(self._v, self._w, error, gap, self._speed, self._following is None)
        return self._v, self._w

    def _gap(self, x: float, y: float) -> float:
        return math.hypot(self._target[0] - x, self._target[1] - y)


def start_of(points: Floats) -> tuple[float, float, float]:
    """The pose at the first of way points (k, 2), looking at the second."""
    x, y = (float(value) for value in points[0])
    return x, y, math.atan2(points[1, 1] - y, points[1, 0] - x)


def arc(x: float, y: float, heading: float, v: float, w: float) -> tuple[float, float, float]:
    """The pose after driving for STEP from one at a speed and a turn rate."""
    half = w * STEP / 2
    chord = v * STEP * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + 2 * half


def drive_path(points: Floats, speed: float, duration: float | None = None) -> Path:
    """Drive through way points (k, 2) in metres at a speed in m/s.

    Without a duration (seconds) the robot stops at the last point. With one it goes on as long; see `Steering`.
    """
    steering = Steering(points, speed, endless=duration is not None)
    pose = start_of(points)
    poses: list[tuple[float, float, float]] = []
    twists: list[tuple[float, float]] = []
    limit = _longest(points, speed) if duration is None else duration
    while len(poses) * STEP < limit and (twist := steering.step(*pose)) is not None:
        poses.append(pose)
        twists.append(twist)
        pose = arc(*pose, *twist)
    rest = round(STANDSTILL / STEP) if duration is None else 0
    poses += [pose] * rest
    twists += [(0.0, 0.0)] * rest
    return Path(np.array(poses).reshape(-1, 3), np.array(twists).reshape(-1, 2))


def _longest(points: Floats, speed: float) -> float:
    """Seconds after which a robot is not waited for that circles around a way point it cannot reach."""
    length = np.hypot(*np.diff(points, axis=0).T).sum()
    return float(60.0 + 10.0 * len(points) + 4.0 * length / speed)


def _way_points(points: Floats, endless: bool) -> Iterator[tuple[float, float]]:
    """The way points after the first."""
    onward = [(float(x), float(y)) for x, y in points]
    if not endless:
        yield from onward[1:]
    elif onward[0] == onward[-1]:
        yield from cycle(onward[1:])
    else:
        yield from cycle(onward[1:] + onward[-2::-1])


def _steer(v: float, w: float, error: float, gap: float, speed: float, last: bool) -> tuple[float, float]:
    """The next speed and turn rate, for a heading error (radians) and the distance to the target (metres)."""
    error = math.remainder(error, 2 * math.pi)
    wanted_w = max(-TURN_RATE, min(TURN_RATE, STEERING * error))
    wanted_v = speed * max(0.0, math.cos(error)) ** 4  # slow in bends, standing where the target is abeam
    if last:
        wanted_v = min(wanted_v, math.sqrt(ACCELERATION * gap))
    dv, dw = ACCELERATION * STEP, TURN_ACCELERATION * STEP
    braking = 3 * dv  # stopping is quicker than starting
    return max(v - braking, min(v + dv, wanted_v)), max(w - dw, min(w + dw, wanted_w))


def odometry(path: Path, times: Floats, drive: Drive, biases: Biases, random: np.random.Generator) -> Floats:
    """The poses (n, 3) that the wheels tell at times (n,), starting from [0, 0, 0].

    Between two readings each wheel's travel is measured as its bias times the true travel plus slip;
    readings add encoder noise. The poses are dead reckoning over these with the biased wheelbase, along
    arcs.
    """
    true_v, true_w = _travel(path, times)
    offset = np.array([-0.5, 0.5]) * drive.wheelbase
    wheels = true_v[:, None] + true_w[:, None] * offset  # (n - 1, 2) left, right
    slip = drive.slip * np.sqrt(np.abs(wheels)) * random.standard_normal(wheels.shape)
    wheels = wheels * [biases.left, biases.right] + slip
    readings = np.vstack([np.zeros(2), np.cumsum(wheels, axis=0)])
    readings += drive.encoder * random.standard_normal(readings.shape)
    left, right = np.diff(readings, axis=0).T
    turn = (right - left) / (drive.wheelbase * biases.wheelbase)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    chord = (left + right) / 2 * np.sinc(turn / (2 * np.pi))  # numpy's sinc(x) is sin(pi x) / (pi x)
    direction = heading[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(direction))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(direction))])
    return np.column_stack([x, y, wrap(heading)])


def _travel(path: Path, times: Floats) -> tuple[Floats, Floats]:
    """The way (metres) and the turn (radians) between successive times (n,), each (n - 1,)."""
    edges = np.arange(len(path.twists) + 1) * STEP
    total = np.vstack([np.zeros(2), np.cumsum(path.twists * STEP, axis=0)])
    v, w = (np.interp(times, edges, total[:, i]) for i in (0, 1))
    return np.diff(v), np.diff(w)
