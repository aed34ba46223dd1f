"""The robot's true motion, computed as time passes, and the pilots that steer it."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from ..bases.interface import Velocity
from ..messages import Floats
from ..se2 import Pose, wrap
from ..simulation.raycast import TIME_STEP, cast_beams, poses_at
from ..simulation.trajectory import MAX_ACCELERATION, MAX_TURN_ACCELERATION, WaypointFollower, drive_arc, start_pose
from ..simulation.world import World

HISTORY_DURATION = 3.0
"""Seconds of motion that are kept at least; devices need the motion since the last step."""
ROBOT_RADIUS = 0.20
"""Metres from the robot's centre to its bumper, in all directions."""
BRAKING_FACTOR = 3.0
"""Ratio of deceleration to acceleration."""


class Pilot(Protocol):
    """Steering of the robot."""

    def steer(self, x: float, y: float, heading: float) -> tuple[float, float]:
        """Return speed (m/s) and turn rate (rad/s) for the next step from a pose."""
        ...


class PathPilot:
    """Pilot along a world's way points, without end; see `trajectory.WaypointFollower`."""

    def __init__(self, world: World) -> None:
        self._steering = WaypointFollower(world.waypoints, world.speed, endless=True)

    def steer(self, x: float, y: float, heading: float) -> tuple[float, float]:
        """Return the next step along the path."""
        return self._steering.step(x, y, heading) or (0.0, 0.0)


class CommandedPilot:
    """Pilot that follows commanded velocities, and stops at walls.

    target  last commanded velocity
    """

    def __init__(self, world: World) -> None:
        self.target = Velocity(0.0, 0.0)
        self._world = world
        self._v = self._w = 0.0

    def steer(self, x: float, y: float, heading: float) -> tuple[float, float]:
        """Return the target velocity within the limits of acceleration; no speed towards obstacles nearer than
        ROBOT_RADIUS.
        """
        self._v = _approach(self._v, self.target.speed, MAX_ACCELERATION * TIME_STEP)
        self._w = _approach(self._w, self.target.turn_rate, MAX_TURN_ACCELERATION * TIME_STEP)
        if self._v != 0.0:
            ahead_x, ahead_y, _ = drive_arc(x, y, heading, self._v, self._w)
            after = clearance(ahead_x, ahead_y, self._world)
            if after < ROBOT_RADIUS and after < clearance(x, y, self._world):
                self._v = 0.0
        return self._v, self._w


def _approach(value: float, target: float, step: float) -> float:
    """Return a value changed towards `target` by at most `step` away from zero, and by BRAKING_FACTOR times as much
    towards zero.
    """
    room = step * BRAKING_FACTOR if abs(target) < abs(value) or target * value < 0.0 else step
    return value + max(-room, min(room, target - value))


def clearance(x: float, y: float, world: World) -> float:
    """Return the distance in metres from a point to the nearest wall, box or column."""
    start, along = world.segments[:, :2], world.segments[:, 2:] - world.segments[:, :2]
    to = np.array([x, y]) - start
    share = np.clip((to * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    gaps = np.hypot(*(to - share[:, None] * along).T)
    round_gaps = np.abs(np.hypot(world.circles[:, 0] - x, world.circles[:, 1] - y) - world.circles[:, 2])
    return float(min(gaps.min(initial=math.inf), round_gaps.min(initial=math.inf)))


class RobotMotion:
    """Arcs of one simulation step each, from the world's first way point on; the last HISTORY_DURATION seconds are
    kept.

    world  in which the robot drives
    """

    def __init__(self, world: World, pilot: Pilot) -> None:
        self.world = world
        self._pilot = pilot
        self._history_steps = round(HISTORY_DURATION / TIME_STEP)
        self._poses, self._twists = np.empty((2 * self._history_steps, 3)), np.empty((2 * self._history_steps, 2))
        # metres driven and radians turned at the beginning of each step
        self._travelled_at_steps = np.empty((2 * self._history_steps, 2))
        self._first = 0  # number of the step in row 0
        self._count = 0
        self._pose = start_pose(world.waypoints)
        self._travelled = (0.0, 0.0)
        self.advance(0.0)

    def advance(self, time: float) -> None:
        """Drive up to a time, and to the end of the step that contains it."""
        while (self._first + self._count) * TIME_STEP <= time + TIME_STEP:
            self._step()

    def _step(self) -> None:
        if self._count == len(self._poses):
            for rows in (self._poses, self._twists, self._travelled_at_steps):
                rows[: self._history_steps] = rows[self._history_steps :]
            self._first, self._count = self._first + self._history_steps, self._history_steps
        v, w = self._pilot.steer(*self._pose)
        row = self._count
        self._poses[row], self._twists[row], self._travelled_at_steps[row] = self._pose, (v, w), self._travelled
        self._count += 1
        self._pose = drive_arc(*self._pose, v, w)
        self._travelled = (self._travelled[0] + v * TIME_STEP, self._travelled[1] + w * TIME_STEP)

    def poses(self, times: Floats) -> Pose:
        """Return the true poses (n, 3) at times (n,), in the world's frame."""
        poses = poses_at(times - self._first * TIME_STEP, self._poses[: self._count], self._twists[: self._count])
        poses[:, 2] = wrap(poses[:, 2])
        return poses

    def travelled(self, time: float) -> tuple[float, float]:
        """Return the metres driven, forwards positive, and the radians turned since the start."""
        row = min(max(int(time / TIME_STEP) - self._first, 0), self._count - 1)
        elapsed = time - (self._first + row) * TIME_STEP
        (v, w), (distance, turn) = self._twists[row], self._travelled_at_steps[row]
        return float(distance + v * elapsed), float(turn + w * elapsed)

    def cast_beams(self, times: Floats, bearings: Floats, mount: Pose) -> Floats:
        """Return the true ranges (n,) of beams of a lidar mounted at `mount`, each at its time and bearing; see
        `raycast`.
        """
        poses, twists = self._poses[: self._count], self._twists[: self._count]
        world = self.world
        return np.asarray(
            cast_beams(times - self._first * TIME_STEP, bearings, mount, poses, twists, world.segments, world.circles)
        )
