"""The lines of one scan in the form that registration, association and the graph work with.

A segment is a frame on the wall: origin at the segment's centre, x along the wall so that the robot is on the left
(y > 0 is the side the wall is seen from). What a line tells of that frame is its offset across the wall and its
direction; along the wall it tells nothing. So a segment carries the covariance of (y, heading) in its own frame:
there it is nearly diagonal, stays Gaussian for short and far segments, and does not depend on the lidar's mount.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers import se2

if TYPE_CHECKING:  # the features bring numba along, which takes a second to load
    from features.types import Corners, Lines

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """n wall segments seen from one pose.

    frame        (n, 3) the segments' frames [x, y, heading] in the base's frame (metres, radians)
    half_length  (n,) metres from the centre to either end
    covariance   (n, 2, 2) of (offset across the wall in metres, heading in radians) at the centre
    """

    frame: Floats
    half_length: Floats
    covariance: Floats

    def __len__(self) -> int:
        return len(self.frame)

    def reach(self) -> float:
        """Distance of the farthest point of any segment from the base, at most (metres)."""
        return float(np.max(np.hypot(self.frame[:, 0], self.frame[:, 1]) + self.half_length, initial=0.0))


def segments_from_lines(lines: Lines, mount: se2.Pose) -> Segments:
    """Lines in the lidar's frame as segments in the base's frame; `mount` is the lidar's pose in the base's frame.

    With d = 1/|(u, v)|, a change of (u, v) moves the wall at its centre c by d (c . d(u, v)) to its left and turns it
    by d^2 (-v du + u dv).
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
    """m corners seen from one pose.

    position    (m, 2) in the base's frame, metres
    covariance  (m, 2, 2)
    segments    (m, 2) indices of the segments before and after the corner, counter-clockwise
    headings    (m, 2) of those segments in the base's frame
    """

    position: Floats
    covariance: Floats
    segments: NDArray[np.int64]
    headings: Floats

    def __len__(self) -> int:
        return len(self.position)


def corner_points(corners: Corners, segments: Segments, mount: se2.Pose) -> CornerPoints:
    """Corners in the lidar's frame moved into the base's frame; `mount` is the lidar's pose in the base's frame."""
    c, s = np.cos(mount[2]), np.sin(mount[2])
    rotation = np.array([[c, -s], [s, c]])
    position = se2.transform(mount, corners.position).reshape(-1, 2)
    headings = segments.frame[corners.lines, 2].reshape(-1, 2)
    return CornerPoints(position, rotation @ corners.covariance @ rotation.T, corners.lines, headings)
