"""Convert the lines and corners of one scan in the lidar's frame to segments and corners in the base's frame."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from .segments import CornerPoints, Segments

if TYPE_CHECKING:
    from features.types import Corners, Lines

# Nodes and weights for integrals over the beams of a segment. Origin: numerical.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
# Metres from the lidar to the line of a wall, for conditioning. Origin: numerical.
MIN_WALL_DISTANCE = 1e-3
SMALLEST = float(np.finfo(float).tiny)


def segments_from_lines(lines: Lines, mount: se2.Pose) -> Segments:
    """Convert lines u x + v y = 1 in the lidar's frame to segments in the base's frame.

    `mount` is the lidar's pose in the base's frame. The covariance is propagated to first order: with d = 1/|(u, v)|,
    a change of (u, v) moves the wall at its centre c by d (c . d(u, v)) to its left and turns it by
    d^2 (-v du + u dv).
    """
    uv = lines.uv
    distance = 1.0 / np.hypot(uv[:, 0], uv[:, 1])
    centre = 0.5 * (lines.start + lines.end)
    along = lines.end - lines.start
    heading = np.arctan2(uv[:, 1], uv[:, 0]) + np.pi / 2
    jacobian = np.empty((len(uv), 2, 2))
    jacobian[:, 0] = distance[:, None] * centre
    jacobian[:, 1, 0] = -(distance**2) * uv[:, 1]
    jacobian[:, 1, 1] = distance**2 * uv[:, 0]
    covariance = jacobian @ lines.covariance @ jacobian.transpose(0, 2, 1)
    frame = se2.compose(mount, np.column_stack([centre, heading]))
    half_length = 0.5 * np.hypot(along[:, 0], along[:, 1])
    in_lidar_frame = np.column_stack([centre, heading]).reshape(-1, 3)
    return Segments(frame.reshape(-1, 3), half_length, covariance, _bias_slopes(in_lidar_frame, half_length))


@compiled
def _bias_slopes(frames, half_lengths):  # type: ignore[no-untyped-def]
    """Return offset and heading (n, 2) of segments, seen from the origin, per metre that all ranges are too long.

    A beam that meets the wall at an angle a from the perpendicular moves its point across the wall by cos a, away from
    the lidar. The line is fitted to these points with the weights 1 / cos^2 a of beams with equal range noise and equal
    angles between them; the sums over the beams are integrals over a, by Gauss-Legendre quadrature.
    """
    slopes = np.empty((len(frames), 2))
    for k in range(len(frames)):
        c, s = math.cos(frames[k, 2]), math.sin(frames[k, 2])
        start = -c * frames[k, 0] - s * frames[k, 1]  # the lidar in the segment's frame, at y > 0
        distance = max(s * frames[k, 0] - c * frames[k, 1], MIN_WALL_DISTANCE)
        low = math.atan2(-half_lengths[k] - start, distance)
        high = math.atan2(half_lengths[k] - start, distance)
        total = first = second = moved = turned = 0.0
        for node in range(len(NODES)):
            angle = 0.5 * (high + low + (high - low) * NODES[node])
            along, cosine = distance * math.tan(angle) + start, math.cos(angle)
            weight = WEIGHTS[node] / cosine**2
            total, first, second = total + weight, first + weight * along, second + weight * along**2
            moved, turned = moved - weight * cosine, turned - weight * cosine * along
        determinant = max(total * second - first**2, SMALLEST)
        slopes[k, 0] = (second * moved - first * turned) / determinant
        slopes[k, 1] = (total * turned - first * moved) / determinant
    return slopes


def corner_points(corners: Corners, segments: Segments, mount: se2.Pose) -> CornerPoints:
    """Transform corners from the lidar's frame to the base's; `mount` is the lidar's pose in the base's frame."""
    c, s = np.cos(mount[2]), np.sin(mount[2])
    rotation = np.array([[c, -s], [s, c]])
    position = se2.transform(mount, corners.position).reshape(-1, 2)
    headings = segments.frame[corners.lines, 2].reshape(-1, 2)
    return CornerPoints(position, rotation @ corners.covariance @ rotation.T, corners.lines, headings)
