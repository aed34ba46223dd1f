"""Visibility comparison: what a map should show from the views of an aligned submap, against what was seen.

Rays are cast in all directions from the submap's views; along each ray the nearest segment of the view is compared with
the nearest wall of the map. A segment seen through a wall of the map, or in front of it where the map has none,
contradicts the alignment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.segments import Floats, Segments
from .map_descriptor import MapDescriptor

# Rays per view: one every 3 degrees. Origin: chosen, for speed; not measured.
RAYS = 120
# Views of a submap that are compared: neighbouring ones see much the same. Origin: chosen, for speed; not measured.
MAX_COMPARED_VIEWS = 12
# Metres by which the stretches of the map's walls are shortened at both ends, for doors and errors of the pose.
# Origin: chosen; not measured.
STRETCH_SHORTENING = 0.2
# Metres between the ranges of one wall in the view and in the map; satisfied by either this or RAY_OFFSET_TOLERANCE.
# Origin: chosen; not measured.
RAY_RANGE_TOLERANCE = 0.3
# The same across the wall, metres: for rays at grazing incidence. Origin: chosen; not measured.
RAY_OFFSET_TOLERANCE = 0.2
# Metres beyond a view's reach in which walls of the map are considered. Origin: chosen; not measured.
REACH_MARGIN = 1.0


@dataclass(frozen=True, slots=True)
class VisibilityCounts:
    """Numbers of rays by result.

    agreeing  hit a segment of the view and a wall of the map at the same range
    through   hit a segment behind a wall of the map
    in_front  hit a segment in front of a wall of the map
    unmapped  hit a segment, but no wall of the map
    missing   hit no segment, but a wall of the map within the view's reach
    """

    agreeing: int
    through: int
    in_front: int
    unmapped: int
    missing: int

    @property
    def agreement(self) -> float:
        """Share of agreeing rays among those that hit something in view and map, 0 to 1."""
        return self.agreeing / max(1, self.agreeing + self.through + self.in_front)

    @property
    def contradicted(self) -> float:
        """Share of rays through a wall of the map among those that hit a segment of the view, 0 to 1."""
        return self.through / max(1, self.agreeing + self.through + self.in_front + self.unmapped)


def compare_visibility(
    pose: se2.Pose, views: Sequence[tuple[se2.Pose, Segments]], descriptor: MapDescriptor
) -> VisibilityCounts:
    """Compare the views of a submap with the map if the submap's frame is at `pose` in the map.

    `views` are poses in the submap's frame, each with the segments seen from there.
    """
    chosen = np.linspace(0, len(views) - 1, min(len(views), MAX_COMPARED_VIEWS)).round().astype(int)
    ends = _shortened_stretches(descriptor)
    counts = np.zeros(5, dtype=np.int64)
    for view_pose, segments in (views[k] for k in chosen):
        if not len(segments):
            continue
        viewpoint = se2.compose(pose, view_pose)
        counts += _compare(viewpoint, segments.frame, segments.half_length, ends, segments.reach())
    return VisibilityCounts(*(int(count) for count in counts))


def _shortened_stretches(descriptor: MapDescriptor) -> Floats:
    """Return the stretches (s, 4) of the walls in the map, first and last point, shortened at both ends."""
    frame = descriptor.frame[descriptor.stretch_wall]
    direction = np.column_stack([np.cos(frame[:, 2]), np.sin(frame[:, 2])])
    length = descriptor.stretches[:, 1] - descriptor.stretches[:, 0]
    shorter = np.minimum(STRETCH_SHORTENING, 0.25 * length)
    low, high = descriptor.stretches[:, 0] + shorter, descriptor.stretches[:, 1] - shorter
    return np.column_stack([frame[:, :2] + low[:, None] * direction, frame[:, :2] + high[:, None] * direction])


@compiled
def _compare(viewpoint, frames, halves, ends, reach):  # type: ignore[no-untyped-def]
    """Count the rays of one view, (5,) in the order of `VisibilityCounts`."""
    counts = np.zeros(5, dtype=np.int64)
    near = np.empty((len(ends), 4))
    count = 0
    c, s = math.cos(viewpoint[2]), math.sin(viewpoint[2])
    for k in range(len(ends)):  # stretches within reach, in the view's frame
        ax, ay = ends[k, 0] - viewpoint[0], ends[k, 1] - viewpoint[1]
        bx, by = ends[k, 2] - viewpoint[0], ends[k, 3] - viewpoint[1]
        half = 0.5 * math.hypot(bx - ax, by - ay)
        if math.hypot(0.5 * (ax + bx), 0.5 * (ay + by)) - half < reach + REACH_MARGIN:
            near[count] = np.array([c * ax + s * ay, c * ay - s * ax, c * bx + s * by, c * by - s * bx])
            count += 1
    for ray in range(RAYS):
        bearing = 2 * math.pi * (ray + 0.5) / RAYS
        rc, rs = math.cos(bearing), math.sin(bearing)
        seen = np.inf
        for i in range(len(frames)):
            hx, hy = halves[i] * math.cos(frames[i, 2]), halves[i] * math.sin(frames[i, 2])
            x, y = frames[i, 0], frames[i, 1]
            seen = min(seen, _range_to_segment(rc, rs, x - hx, y - hy, x + hx, y + hy))
        expected, incidence = np.inf, 1.0
        facing = False
        for k in range(count):
            ax, ay, bx, by = near[k]
            distance = _range_to_segment(rc, rs, ax, ay, bx, by)
            if distance < expected:
                length = math.hypot(bx - ax, by - ay)
                expected, incidence = distance, abs(rc * (by - ay) - rs * (bx - ax)) / length
                facing = ax * by - ay * bx > 0  # the viewpoint is on the wall's visible side
        if seen == np.inf:
            counts[4] += expected < reach
        elif expected == np.inf:
            counts[3] += 1
        elif abs(seen - expected) < RAY_RANGE_TOLERANCE or abs(seen - expected) * incidence < RAY_OFFSET_TOLERANCE:
            counts[0] += facing
            counts[3] += not facing
        elif expected < seen:
            counts[1] += 1
        else:
            counts[2] += 1
    return counts


@compiled
def _range_to_segment(rc, rs, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Return the range along the ray (rc, rs) from the origin to the segment a-b, infinite if the ray misses it."""
    side_a, side_b = rc * ay - rs * ax, rc * by - rs * bx
    if side_a * side_b > 0.0 or side_a == side_b:
        return np.inf
    part = side_a / (side_a - side_b)
    distance = rc * (ax + part * (bx - ax)) + rs * (ay + part * (by - ay))
    return distance if distance > 0.0 else np.inf
