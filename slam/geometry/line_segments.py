"""Convert the lines and corners of one scan in the lidar's frame to segments and corners in the base's frame."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from .angles import wrap_angle
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
    # contiguous, as columns of a table would be compiled for separately
    uv, start, end, of_uv = (array.copy() for array in (lines.uv, lines.start, lines.end, lines.covariance))
    return Segments(*_segments(uv, start, end, of_uv, tuple(mount.tolist())))


@compiled
def _segments(uv, starts, ends, covariances, mount):  # type: ignore[no-untyped-def]
    """Return the fields of `Segments`."""
    count = len(uv)
    frame, in_lidar_frame = np.empty((count, 3)), np.empty((count, 3))
    half_length, covariance = np.empty(count), np.empty((count, 2, 2))
    c, s = math.cos(mount[2]), math.sin(mount[2])
    for k in range(count):
        u, v = uv[k]
        distance = 1.0 / math.hypot(u, v)
        x, y = 0.5 * (starts[k, 0] + ends[k, 0]), 0.5 * (starts[k, 1] + ends[k, 1])
        heading = math.atan2(v, u) + 0.5 * math.pi
        half_length[k] = 0.5 * math.hypot(ends[k, 0] - starts[k, 0], ends[k, 1] - starts[k, 1])
        in_lidar_frame[k, 0], in_lidar_frame[k, 1], in_lidar_frame[k, 2] = x, y, heading
        frame[k, 0], frame[k, 1] = mount[0] + c * x - s * y, mount[1] + s * x + c * y
        frame[k, 2] = wrap_angle(mount[2] + heading)
        of_u, of_v, turn_u, turn_v = distance * x, distance * y, -(distance**2) * v, distance**2 * u
        uu, mixed, vv = covariances[k, 0, 0], covariances[k, 0, 1], covariances[k, 1, 1]
        covariance[k, 0, 0] = of_u * of_u * uu + 2.0 * of_u * of_v * mixed + of_v * of_v * vv
        covariance[k, 1, 1] = turn_u * turn_u * uu + 2.0 * turn_u * turn_v * mixed + turn_v * turn_v * vv
        both = of_u * turn_u * uu + (of_u * turn_v + of_v * turn_u) * mixed + of_v * turn_v * vv
        covariance[k, 0, 1] = covariance[k, 1, 0] = both
    return frame, half_length, covariance, _bias_slopes(in_lidar_frame, half_length)


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
    # contiguous, as columns of a table would be compiled for separately
    position, covariance = corners.position.copy(), corners.covariance.copy()
    placed = _corners(position, covariance, corners.lines, segments.frame, tuple(mount.tolist()))
    return CornerPoints(placed[0], placed[1], corners.lines, placed[2])


@compiled
def _corners(positions, covariances, lines, frames, mount):  # type: ignore[no-untyped-def]
    """Return positions and covariances R C R' of corners in the base's frame, and the headings of their segments."""
    count = len(positions)
    position, covariance, headings = np.empty((count, 2)), np.empty((count, 2, 2)), np.empty((count, 2))
    c, s = math.cos(mount[2]), math.sin(mount[2])
    for k in range(count):
        x, y = positions[k]
        position[k, 0], position[k, 1] = mount[0] + c * x - s * y, mount[1] + s * x + c * y
        xx, mixed, yy = covariances[k, 0, 0], covariances[k, 0, 1], covariances[k, 1, 1]
        covariance[k, 0, 0] = c * c * xx - 2.0 * c * s * mixed + s * s * yy
        covariance[k, 1, 1] = s * s * xx + 2.0 * c * s * mixed + c * c * yy
        covariance[k, 0, 1] = covariance[k, 1, 0] = c * s * (xx - yy) + (c * c - s * s) * mixed
        headings[k, 0], headings[k, 1] = frames[lines[k, 0], 2], frames[lines[k, 1], 2]
    return position, covariance, headings
