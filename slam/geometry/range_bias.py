"""Effect of a range bias on the segments and corners of a scan, and its removal."""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined

from .angles import wrap_angle
from .segments import CornerPoints, Floats, Segments


def corner_bias_slopes(segments: Segments, corners: CornerPoints) -> Floats:
    """Return the motion (m, 2) of corners in the base's frame per metre of range bias: their two lines move."""
    return np.asarray(_corner_slopes(segments.frame, segments.bias_slope, corners.position, corners.segments))


def without_range_bias(segments: Segments, corners: CornerPoints, bias: float) -> tuple[Segments, CornerPoints]:
    """Return segments and corners as if all ranges were shorter by `bias` metres."""
    frame, position, headings = _without_bias(
        segments.frame, segments.bias_slope, corners.position, corners.segments, bias
    )
    moved = Segments(frame, segments.half_length, segments.covariance, segments.bias_slope)
    return moved, CornerPoints(position, corners.covariance, corners.segments, headings)


@compiled
def _corner_slopes(frames, slopes, positions, segments):  # type: ignore[no-untyped-def]
    """Return the motion (m, 2) of each corner by the equations c y - s x = shift across each of its two lines."""
    result = np.empty_like(positions)
    for k in range(len(positions)):
        a, b = segments[k]
        c1, s1, c2, s2 = math.cos(frames[a, 2]), math.sin(frames[a, 2]), math.cos(frames[b, 2]), math.sin(frames[b, 2])
        first = slopes[a, 0] + slopes[a, 1] * _along(frames[a], positions[k], c1, s1)
        second = slopes[b, 0] + slopes[b, 1] * _along(frames[b], positions[k], c2, s2)
        determinant = c1 * s2 - s1 * c2
        result[k, 0], result[k, 1] = (c2 * first - c1 * second) / determinant, (s2 * first - s1 * second) / determinant
    return result


@inlined
def _along(frame, position, c, s):  # type: ignore[no-untyped-def]
    """Return the metres from a frame to a position along the frame's x, which points to (c, s)."""
    return c * (position[0] - frame[0]) + s * (position[1] - frame[1])


@compiled
def _without_bias(frames, slopes, positions, segments, bias):  # type: ignore[no-untyped-def]
    """Return the frames of segments, and positions and headings of corners, without a range bias."""
    moved = np.empty_like(frames)
    for k in range(len(frames)):
        x, y, heading = frames[k]
        shift = -bias * slopes[k, 0]
        moved[k, 0], moved[k, 1] = x - math.sin(heading) * shift, y + math.cos(heading) * shift
        moved[k, 2] = wrap_angle(heading - bias * slopes[k, 1])
    headings = np.empty(segments.shape)
    for k in range(len(segments)):
        headings[k, 0], headings[k, 1] = moved[segments[k, 0], 2], moved[segments[k, 1], 2]
    return moved, positions - bias * _corner_slopes(frames, slopes, positions, segments), headings
