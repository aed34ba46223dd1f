"""Ray casting for a lidar on a moving robot; compiled, since it takes most of the simulator's time."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import compiled
from ..messages import Floats

TIME_STEP = 0.01
"""Seconds. Speed and turn rate are constant for this long: the trajectory is a sequence of such arcs."""


@compiled
def pose_at(time: float, poses: Floats, twists: Floats) -> tuple[float, float, float]:
    """Return the pose x, y, heading at a time (seconds) on a trajectory of arcs.

    poses   (k, 3) at the beginning of each TIME_STEP
    twists  (k, 2) speed (m/s) and turn rate (rad/s) during it
    """
    k = min(max(int(time / TIME_STEP), 0), poses.shape[0] - 1)
    x, y, heading = poses[k]
    speed, rate = twists[k]
    elapsed = time - k * TIME_STEP
    turn = rate * elapsed
    # The chord of an arc of length s that turns by a is s sin(a/2) / (a/2) long and points along heading + a/2.
    half = turn / 2.0
    chord = speed * elapsed * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + turn


@compiled
def poses_at(times: Floats, poses: Floats, twists: Floats) -> Floats:
    """Return the poses (n, 3) at times (n,) on the trajectory given by `poses` and `twists` (see `pose_at`)."""
    result = np.empty((times.shape[0], 3))
    for i in range(times.shape[0]):
        result[i] = pose_at(times[i], poses, twists)
    return result


@compiled
def ray_distance(x: float, y: float, heading: float, segments: Floats, circles: Floats) -> float:
    """Return the distance (metres) along a ray from x, y to the first segment or circle; infinite if there is none.

    segments  (n, 4) x0 y0 x1 y1
    circles   (m, 3) x y radius; a ray that starts within a circle does not meet it
    """
    dx, dy = math.cos(heading), math.sin(heading)
    nearest = math.inf
    for i in range(segments.shape[0]):
        # x + t d = a + s e: s = (a - x) x d / (d x e) in [0, 1], t = (a - x) x e / (d x e) > 0
        ax, ay = segments[i, 0] - x, segments[i, 1] - y
        ex, ey = segments[i, 2] - segments[i, 0], segments[i, 3] - segments[i, 1]
        det = dx * ey - dy * ex
        along = ax * dy - ay * dx
        if (det > 0.0 and 0.0 <= along <= det) or (det < 0.0 and det <= along <= 0.0):
            t = (ax * ey - ay * ex) / det
            if 0.0 < t < nearest:
                nearest = t
    for i in range(circles.shape[0]):
        cx, cy, radius = circles[i, 0] - x, circles[i, 1] - y, circles[i, 2]
        middle = cx * dx + cy * dy
        inside = radius * radius - (cx * cx + cy * cy - middle * middle)
        if inside >= 0.0:
            t = middle - math.sqrt(inside)
            if 0.0 < t < nearest:
                nearest = t
    return nearest


@compiled
def cast_beams(
    times: Floats,
    bearings: Floats,
    mount: Floats,
    poses: Floats,
    twists: Floats,
    segments: Floats,
    circles: Floats,
) -> Floats:
    """Return the noise-free ranges (n,) of a lidar on a moving robot, metres; infinite if a beam meets nothing.

    times     (n,) time of each beam, seconds, on the trajectory given by `poses` and `twists` (see `pose_at`)
    bearings  (n,) direction of each beam in the lidar's frame, radians
    mount     [x, y, heading] of the lidar on the robot
    segments, circles  shapes of the world (see `ray_distance`)
    """
    result = np.empty(times.shape[0])
    for i in range(times.shape[0]):
        x, y, heading = pose_at(times[i], poses, twists)
        c, s = math.cos(heading), math.sin(heading)
        result[i] = ray_distance(
            x + c * mount[0] - s * mount[1],
            y + s * mount[0] + c * mount[1],
            heading + mount[2] + bearings[i],
            segments,
            circles,
        )
    return result
