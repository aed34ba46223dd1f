"""Segments and corners of one scan in the base's frame, as used by registration, data association and the graph.

A segment has a frame on the wall: origin at the segment's centre, x along the wall, the robot at y > 0. A line measures
the offset of this frame across the wall and its heading, but nothing along the wall. So a segment carries the
covariance of (offset, heading) in its own frame, where it is nearly diagonal, stays Gaussian for short and distant
segments, and does not depend on the lidar's mount.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from drivers.compiled import compiled, inlined

from .angles import wrap_angle

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Wall segments of one scan.

    frame        (n, 3) the segments' frames [x, y, heading] in the base's frame, metres and radians
    half_length  (n,) metres from the centre to either end
    covariance   (n, 2, 2) of offset across the wall (metres) and heading (radians) at the centre
    bias_slope   (n, 2) offset and heading at the centre per metre of range bias; zero if not given
    """

    frame: Floats
    half_length: Floats
    covariance: Floats
    bias_slope: Floats = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        if len(self.bias_slope) != len(self.frame):
            object.__setattr__(self, "bias_slope", np.zeros((len(self.frame), 2)))

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def total_length(self) -> float:
        """Metres of all segments together."""
        return float(2 * self.half_length.sum())

    def reach(self) -> float:
        """Return an upper bound of the distance from the base to any point of a segment, metres; 0 without one."""
        return float(np.max(np.hypot(self.frame[:, 0], self.frame[:, 1]) + self.half_length, initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class CornerPoints:
    """Corners of one scan.

    position    (m, 2) in the base's frame, metres
    covariance  (m, 2, 2) of the position, in the base's axes
    segments    (m, 2) indices of the segments before and after the corner, counter-clockwise
    headings    (m, 2) of these segments in the base's frame, radians
    """

    position: Floats
    covariance: Floats
    segments: NDArray[np.int64]
    headings: Floats

    def __len__(self) -> int:
        return len(self.position)


def corner_bias_slopes(segments: Segments, corners: CornerPoints) -> Floats:
    """Return the motion (m, 2) of corners in the base's frame per metre of range bias: their two lines move."""
    return np.asarray(_corner_slopes(segments.frame, segments.bias_slope, corners.position, corners.segments))


def without_range_bias(segments: Segments, corners: CornerPoints, bias: float) -> tuple[Segments, CornerPoints]:
    """Return segments and corners as if all ranges were shorter by `bias` metres."""
    frame, position, headings = _without_bias(
        segments.frame, segments.bias_slope, corners.position, corners.segments, bias
    )
    return replace(segments, frame=frame), replace(corners, position=position, headings=headings)


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
