"""Surfaces that two scans have both seen, and what they contribute to matching one with the other.

A scan is matched with the points of all keyframes around it. Its pose relative to one of them, a reference, is measured
by the surfaces that the reference has seen. Other surfaces were placed by other keyframes, and the match does not show
the errors of these relative to the reference. Surfaces in space that the reference has seen to be free have moved, as
people do who walk beside the robot, so they are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats
from ..mapping.sight_lines import MIN_DEPTH
from .distance_field import MIN_FACING
from .offset_tiles import MAX_DISTANCE
from .point_costs import COARSE_SIGMA
from .point_matcher import POINT_SPACING, point_information

# Share of its trace that is added to an information matrix, as differences are rounded. Origin: numerical.
CONDITIONING = 1e-9
# Points on surfaces that the reference has seen, on others, and where it has seen free space. Origin: definition.
SHARED, NEW, MOVED = 0, 1, 2


def split_information(
    information: Floats, references: Sequence[Floats], points: Floats, relatives: Sequence[se2.Pose]
) -> list[tuple[int, Floats]]:
    """Divide the information of a match among several references: return (row of a reference, its part (3, 3)) pairs.

    Points on surfaces that the oldest reference has seen count relative to it. Of the other points, those on surfaces
    of the next reference count relative to that, if they are at least half of the others, and so on. The points left in
    the end count relative to the latest reference. So there is no reference for a few points, which would only make the
    graph larger. References of which the match measures nothing are left out.

    With the information A of all points of the scan and B of some of them, the part of M that is from these is
    M^(1/2) A^(-1/2) B A^(-1/2) M^(1/2), with symmetric roots. M need not be from all points of the scan.

    information  M, of the scan's pose in its own frame
    references   (p, 6) points of each reference with their normals, in its frame, the oldest one first
    points       (q, 6) those of the scan, in its frame
    relatives    pose of the scan in the frame of each reference
    """
    whole, left, parts = point_information(points), points, list[tuple[int, Floats]]()
    scales, directions = np.linalg.eigh(whole + CONDITIONING * (1.0 + np.trace(whole)) * np.eye(3))
    values, vectors = np.linalg.eigh(information)
    factor = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T @ (directions / np.sqrt(scales)) @ directions.T
    for row in range(len(references) - 1):
        kinds = _compare(references[row], left, relatives[row])
        if row == 0 or 2 * np.count_nonzero(kinds == SHARED) >= len(left):
            parts.append((row, left[kinds == SHARED]))
            left = left[kinds == NEW]
    parts.append((len(references) - 1, left))
    return [(row, factor @ point_information(part) @ factor.T) for row, part in parts if len(part)]


@compiled
def _compare(reference, points, relative):  # type: ignore[no-untyped-def]
    """Return (q,) SHARED, NEW or MOVED for each point, for the arguments see `split_information`.

    A point is shared if it is on the surface of a point of the reference nearby, and faces the same way. It has moved
    if a beam of the reference has passed it: to a point that is farther away in the same direction, seen from the
    reference's base, which is near its lidar.
    """
    c, s = math.cos(relative[2]), math.sin(relative[2])
    ranges, kinds = np.hypot(reference[:, 0], reference[:, 1]), np.full(len(points), NEW)
    for k in range(len(points)):
        x, y = relative[0] + c * points[k, 0] - s * points[k, 1], relative[1] + s * points[k, 0] + c * points[k, 1]
        normal_x, normal_y = c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3]
        for j in range(len(reference)):
            if _is_on_surface(reference[j], x, y, normal_x, normal_y):
                kinds[k] = SHARED
                break
            if kinds[k] == NEW and _passes(reference[j], ranges[j], x, y):
                kinds[k] = MOVED
    return kinds


@inlined
def _is_on_surface(point, x, y, normal_x, normal_y):  # type: ignore[no-untyped-def]
    """Return True if (x, y) with a normal is near a point (4,), faces the same way, and is on its surface.

    That is up to COARSE_SIGMA across, or from the point itself if that has no normal.
    """
    dx, dy = x - point[0], y - point[1]
    squared, of_surface = dx * dx + dy * dy, point[2] != 0.0 or point[3] != 0.0
    if squared >= MAX_DISTANCE**2 or not _faces_the_same_way(normal_x, normal_y, point[2], point[3]):
        return False
    return (abs(dx * point[2] + dy * point[3]) if of_surface else math.sqrt(squared)) < COARSE_SIGMA


@inlined
def _passes(point, length, x, y):  # type: ignore[no-untyped-def]
    """Return True if the beam to a point, `length` metres, passes (x, y): by less than half of POINT_SPACING."""
    across = y * point[0] - x * point[1]  # this and the next one are multiplied by the length
    along = x * point[0] + y * point[1]
    if abs(across) >= 0.5 * POINT_SPACING * length:
        return False
    return MIN_DEPTH * length < along < (length - MIN_DEPTH) * length


@inlined
def _faces_the_same_way(x, y, other_x, other_y):  # type: ignore[no-untyped-def]
    """Return True if two normals are at most 67.5 degrees apart, or if one is zero, as it is not known."""
    unknown = (x == 0.0 and y == 0.0) or (other_x == 0.0 and other_y == 0.0)
    return unknown or x * other_x + y * other_y > MIN_FACING
