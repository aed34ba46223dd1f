"""Segments and corners of one scan in the base's frame, as used by registration, data association and the graph.

A segment has a frame on the wall: origin at the segment's centre, x along the wall, the robot at y > 0. A line measures
the offset of this frame across the wall and its heading, but nothing along the wall. So a segment carries the
covariance of (offset, heading) in its own frame, where it is nearly diagonal, stays Gaussian for short and distant
segments, and does not depend on the lidar's mount.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers import se2

if TYPE_CHECKING:  # importing features imports numba, which takes a second
    from features.types import Corners, Lines

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Wall segments of one scan.

    frame        (n, 3) the segments' frames [x, y, heading] in the base's frame, metres and radians
    half_length  (n,) metres from the centre to either end
    covariance   (n, 2, 2) of offset across the wall (metres) and heading (radians) at the centre
    """

    frame: Floats
    half_length: Floats
    covariance: Floats

    def __len__(self) -> int:
        return len(self.frame)

    def reach(self) -> float:
        """Return an upper bound of the distance from the base to any point of a segment, metres; 0 without one."""
        return float(np.max(np.hypot(self.frame[:, 0], self.frame[:, 1]) + self.half_length, initial=0.0))


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
    return Segments(frame.reshape(-1, 3), 0.5 * np.hypot(along[:, 0], along[:, 1]), covariance)


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


def corner_points(corners: Corners, segments: Segments, mount: se2.Pose) -> CornerPoints:
    """Transform corners from the lidar's frame to the base's; `mount` is the lidar's pose in the base's frame."""
    c, s = np.cos(mount[2]), np.sin(mount[2])
    rotation = np.array([[c, -s], [s, c]])
    position = se2.transform(mount, corners.position).reshape(-1, 2)
    headings = segments.frame[corners.lines, 2].reshape(-1, 2)
    return CornerPoints(position, rotation @ corners.covariance @ rotation.T, corners.lines, headings)
