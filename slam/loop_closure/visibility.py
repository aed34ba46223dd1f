"""What would have been seen of a map from where a fragment is believed to lie, and what was seen instead.

Rays go out in all directions from the fragment's views; along each the nearest thing in the view is compared with the
nearest in the map. What was seen through a wall of the map, or in front of it where the map knows of nothing, speaks
against the place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivers import se2

from ..geometry.segments import Floats, Segments
from .map_descriptor import MapDescriptor

RAYS = 120  # of a view
MOST_VIEWS = 12  # of a fragment: neighbouring ones see much the same
SHORTENED = 0.2  # metres by which the stretches of the map's walls are shortened at either end: doors, and errors
SAME_RANGE = 0.3  # metres by which the ranges of the same wall may differ, besides
SAME_ACROSS = 0.2  # metres across a wall by which what was seen may differ from it


@dataclass(frozen=True, slots=True)
class VisibilityCounts:
    """Rays of a fragment's views that hit something in the view, sorted by what the map has there.

    agree    the same at the same range
    through  a wall nearer than what was seen
    front    only something farther
    unknown  nothing
    missing  rays besides that hit nothing in the view, where the map has a wall in reach of what else was seen
    """

    agree: int
    through: int
    front: int
    unknown: int
    missing: int

    @property
    def agreement(self) -> float:
        """Share of the rays that hit something in both that agree."""
        return self.agree / max(1, self.agree + self.through + self.front)

    @property
    def contradicted(self) -> float:
        """Share of all rays that went through a wall."""
        return self.through / max(1, self.agree + self.through + self.front + self.unknown)


def look(place: se2.Pose, views: Sequence[tuple[se2.Pose, Segments]], scene: MapDescriptor) -> VisibilityCounts:
    """Compare what the views saw with the map, where the fragment's frame lies at `place`."""
    chosen = np.linspace(0, len(views) - 1, min(len(views), MOST_VIEWS)).round().astype(int)
    ends = _ends(scene)
    counts = np.zeros(5, dtype=np.int64)
    for pose, segments in (views[k] for k in chosen):
        if not len(segments):
            continue
        eye = se2.compose(place, pose)
        counts += _compare(eye, segments.frame, segments.half_length, ends, segments.reach())
    return VisibilityCounts(*(int(count) for count in counts))


def _ends(scene: MapDescriptor) -> Floats:
    """(s, 4): the stretches of the walls from their first to their last point in the map, shortened."""
    frame = scene.frame[scene.stretch_wall]
    direction = np.column_stack([np.cos(frame[:, 2]), np.sin(frame[:, 2])])
    shorter = np.minimum(SHORTENED, 0.25 * (scene.stretches[:, 1] - scene.stretches[:, 0]))
    low, high = scene.stretches[:, 0] + shorter, scene.stretches[:, 1] - shorter
    return np.column_stack([frame[:, :2] + low[:, None] * direction, frame[:, :2] + high[:, None] * direction])


@njit(cache=True)
def _compare(eye, frames, halves, ends, reach):  # type: ignore[no-untyped-def]
    """Counts (5,) in the order of Sight, of one view."""
    counts = np.zeros(5, dtype=np.int64)
    near = np.empty((len(ends), 4))
    count = 0
    c, s = math.cos(eye[2]), math.sin(eye[2])
    for k in range(len(ends)):  # into the view's frame, as far as in reach
        ax, ay, bx, by = ends[k, 0] - eye[0], ends[k, 1] - eye[1], ends[k, 2] - eye[0], ends[k, 3] - eye[1]
        half = 0.5 * math.hypot(bx - ax, by - ay)
        if math.hypot(0.5 * (ax + bx), 0.5 * (ay + by)) - half < reach + 1.0:
            near[count] = np.array([c * ax + s * ay, c * ay - s * ax, c * bx + s * by, c * by - s * bx])
            count += 1
    for ray in range(RAYS):
        bearing = 2 * math.pi * (ray + 0.5) / RAYS
        rc, rs = math.cos(bearing), math.sin(bearing)
        seen = np.inf
        for i in range(len(frames)):
            hx, hy = halves[i] * math.cos(frames[i, 2]), halves[i] * math.sin(frames[i, 2])
            x, y = frames[i, 0], frames[i, 1]
            seen = min(seen, _range(rc, rs, x - hx, y - hy, x + hx, y + hy))
        expected, steepness = np.inf, 1.0
        facing = False
        for k in range(count):
            ax, ay, bx, by = near[k]
            distance = _range(rc, rs, ax, ay, bx, by)
            if distance < expected:
                length = math.hypot(bx - ax, by - ay)
                expected, steepness = distance, abs(rc * (by - ay) - rs * (bx - ax)) / length
                facing = ax * by - ay * bx > 0  # the eye is on the wall's left
        if seen == np.inf:
            counts[4] += expected < reach
        elif expected == np.inf:
            counts[3] += 1
        elif abs(seen - expected) < SAME_RANGE or abs(seen - expected) * steepness < SAME_ACROSS:
            counts[0] += facing
            counts[3] += not facing
        elif expected < seen:
            counts[1] += 1
        else:
            counts[2] += 1
    return counts


@njit(cache=True)
def _range(rc, rs, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Along the ray (rc, rs) from the origin to the segment a-b, infinite where it misses."""
    side_a, side_b = rc * ay - rs * ax, rc * by - rs * bx
    if side_a * side_b > 0.0 or side_a == side_b:
        return np.inf
    part = side_a / (side_a - side_b)
    distance = rc * (ax + part * (bx - ax)) + rs * (ay + part * (by - ay))
    return distance if distance > 0.0 else np.inf
