"""True motion of the simulated robot: it follows way points in steps of constant speed and turn rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import cycle

import numpy as np

from ..immutable import immutable
from ..messages import Floats
from ..se2 import wrap
from .raycast import TIME_STEP, poses_at

WAYPOINT_RADIUS = 0.25
"""Metres. Closer than this to a way point the robot heads for the next one, which rounds its corners."""
GOAL_RADIUS = 0.05
"""Metres. The same for the last way point."""
MAX_TURN_RATE = 1.0
"""Radians per second."""
HEADING_GAIN = 2.5
"""Turn rate per radian of heading error, 1/s."""
MAX_ACCELERATION = 0.6
"""m/s^2."""
MAX_TURN_ACCELERATION = 4.0
"""rad/s^2."""
STANDSTILL = 1.0
"""Seconds at rest before the start and after the arrival."""


@immutable
class ArcTrajectory:
    """True trajectory, composed of arcs of TIME_STEP seconds.

    poses   (k, 3) at the beginning of each step
    twists  (k, 2) speed (m/s) and turn rate (rad/s) during each step
    """

    poses: Floats
    twists: Floats

    @property
    def duration(self) -> float:
        """Duration, seconds."""
        return len(self.poses) * TIME_STEP

    def poses_at(self, times: Floats) -> Floats:
        """Return poses (n, 3), headings in [-pi, pi), at times (n,) in seconds from the start."""
        poses = poses_at(times, self.poses, self.twists)
        poses[:, 2] = wrap(poses[:, 2])
        return poses


class WaypointFollower:
    """Controller that drives to one way point after the other in steps of TIME_STEP, after STANDSTILL seconds at rest.

    waypoints  (k, 2) metres
    speed      metres per second
    endless    repeat the way points: in a circle if the last one is the first, else back and forth
    """

    def __init__(self, waypoints: Floats, speed: float, endless: bool) -> None:
        self._speed = speed
        self._ahead = _targets(waypoints, endless)
        self._target = next(self._ahead)
        self._following = next(self._ahead, None)
        self._steps_at_rest = round(STANDSTILL / TIME_STEP)
        self._v = self._w = 0.0

    def step(self, x: float, y: float, heading: float) -> tuple[float, float] | None:
        """Return speed (m/s) and turn rate (rad/s) for the next step from a pose; None at the last way point."""
        gap = self._distance(x, y)
        if self._following is None and gap < GOAL_RADIUS:
            return None
        if self._following is not None and gap < WAYPOINT_RADIUS:
            self._target, self._following = self._following, next(self._ahead, None)
            gap = self._distance(x, y)
        if self._steps_at_rest:
            self._steps_at_rest -= 1
        else:
            error = math.atan2(self._target[1] - y, self._target[0] - x) - heading
            self._v, self._w = _control(self._v, self._w, error, gap, self._speed, self._following is None)
        return self._v, self._w

    def _distance(self, x: float, y: float) -> float:
        return math.hypot(self._target[0] - x, self._target[1] - y)


def start_pose(waypoints: Floats) -> tuple[float, float, float]:
    """Return the pose at the first of the way points (k, 2), heading for the second."""
    x, y = (float(value) for value in waypoints[0])
    return x, y, math.atan2(waypoints[1, 1] - y, waypoints[1, 0] - x)


def drive_arc(x: float, y: float, heading: float, v: float, w: float) -> tuple[float, float, float]:
    """Return the pose after TIME_STEP at a speed v (m/s) and a turn rate w (rad/s)."""
    half = w * TIME_STEP / 2
    chord = v * TIME_STEP * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + 2 * half


def follow_waypoints(waypoints: Floats, speed: float, duration: float | None = None) -> ArcTrajectory:
    """Drive through way points (k, 2) in metres at a speed in m/s.

    Without a duration (seconds) the robot stops at the last way point. With one it continues until then, see
    `WaypointFollower`.
    """
    follower = WaypointFollower(waypoints, speed, endless=duration is not None)
    pose = start_pose(waypoints)
    poses: list[tuple[float, float, float]] = []
    twists: list[tuple[float, float]] = []
    limit = _time_limit(waypoints, speed) if duration is None else duration
    while len(poses) * TIME_STEP < limit and (twist := follower.step(*pose)) is not None:
        poses.append(pose)
        twists.append(twist)
        pose = drive_arc(*pose, *twist)
    rest = round(STANDSTILL / TIME_STEP) if duration is None else 0
    poses += [pose] * rest
    twists += [(0.0, 0.0)] * rest
    return ArcTrajectory(np.array(poses).reshape(-1, 3), np.array(twists).reshape(-1, 2))


def _time_limit(waypoints: Floats, speed: float) -> float:
    """Return the duration (seconds) after which a drive ends even if a way point cannot be reached."""
    length = np.hypot(*np.diff(waypoints, axis=0).T).sum()
    return float(60.0 + 10.0 * len(waypoints) + 4.0 * length / speed)


def _targets(waypoints: Floats, endless: bool) -> Iterator[tuple[float, float]]:
    """Yield the way points to head for: those after the first, repeated if `endless`."""
    points = [(float(x), float(y)) for x, y in waypoints]
    if not endless:
        yield from points[1:]
    elif points[0] == points[-1]:
        yield from cycle(points[1:])
    else:
        yield from cycle(points[1:] + points[-2::-1])


def _control(v: float, w: float, error: float, gap: float, speed: float, last: bool) -> tuple[float, float]:
    """Return the next speed and turn rate for a heading error (radians) and a distance to the target (metres)."""
    error = math.remainder(error, 2 * math.pi)
    target_w = max(-MAX_TURN_RATE, min(MAX_TURN_RATE, HEADING_GAIN * error))
    target_v = speed * max(0.0, math.cos(error)) ** 4  # slow in bends, at rest if the target is abeam
    if last:
        target_v = min(target_v, math.sqrt(MAX_ACCELERATION * gap))
    dv, dw = MAX_ACCELERATION * TIME_STEP, MAX_TURN_ACCELERATION * TIME_STEP
    braking = 3 * dv  # braking is stronger than accelerating
    return max(v - braking, min(v + dv, target_v)), max(w - dw, min(w + dw, target_w))
