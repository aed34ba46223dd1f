"""Surfaces that two scans have both seen, and what they contribute to matching one with the other.

A scan is matched with the points of all keyframes around it. Its pose relative to one of them is measured by the
surfaces that this one has seen. Other surfaces were placed by other keyframes, whose errors relative to it the match
does not show.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled, inlined

from ..geometry.segments import Floats
from .distance_field import MIN_FACING
from .offset_tiles import MAX_DISTANCE
from .point_matcher import point_information

# Share of its trace that is added to an information matrix, as differences are rounded. Origin: numerical.
CONDITIONING = 1e-9


def split_information(
    information: Floats, reference: Floats, points: Floats, relative: se2.Pose
) -> tuple[Floats, Floats]:
    """Split the information of a match (3, 3) into that from surfaces which a reference has seen as well, and the rest.

    With the information A of all points of the scan and B of those that are shared, the first part of M is
    M^(1/2) A^(-1/2) B A^(-1/2) M^(1/2), with symmetric roots: M may be from some of the points only.

    information  M, of the scan's pose in its own frame
    reference    (p, 4) points of the reference with their normals, in its frame
    points       (q, 4) those of the scan, in its frame
    relative     pose of the scan in the frame of the reference
    """
    whole, shared = point_information(points), point_information(points[_are_shared(reference, points, relative)])
    scales, directions = np.linalg.eigh(whole + CONDITIONING * (1.0 + np.trace(whole)) * np.eye(3))
    values, vectors = np.linalg.eigh(information)
    factor = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T @ (directions / np.sqrt(scales)) @ directions.T
    of_shared = np.asarray(factor @ shared @ factor.T)
    return of_shared, information - of_shared


@compiled
def _are_shared(reference, points, relative):  # type: ignore[no-untyped-def]
    """Return (q,) True for points within MAX_DISTANCE of a point of the reference whose surface faces the same way."""
    c, s = math.cos(relative[2]), math.sin(relative[2])
    shared = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        x, y = relative[0] + c * points[k, 0] - s * points[k, 1], relative[1] + s * points[k, 0] + c * points[k, 1]
        normal_x, normal_y = c * points[k, 2] - s * points[k, 3], s * points[k, 2] + c * points[k, 3]
        for j in range(len(reference)):
            if math.hypot(reference[j, 0] - x, reference[j, 1] - y) < MAX_DISTANCE and _faces_the_same_way(
                normal_x, normal_y, reference[j, 2], reference[j, 3]
            ):
                shared[k] = True
                break
    return shared


@inlined
def _faces_the_same_way(x, y, other_x, other_y):  # type: ignore[no-untyped-def]
    """Return True if two normals are at most 67.5 degrees apart, or if one is zero, as it is not known."""
    unknown = (x == 0.0 and y == 0.0) or (other_x == 0.0 and other_y == 0.0)
    return unknown or x * other_x + y * other_y > MIN_FACING
