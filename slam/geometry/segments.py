"""Segments and corners of one scan in the base's frame, as used by registration, data association and the graph.

A segment has a frame on the wall: origin at the segment's centre, x along the wall, the robot at y > 0. A line measures
the offset of this frame across the wall and its heading, but nothing along the wall. So a segment carries the
covariance of (offset, heading) in its own frame, where it is nearly diagonal, stays Gaussian for short and distant
segments, and does not depend on the lidar's mount.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@immutable
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
        ends = zip(self.frame.tolist(), self.half_length.tolist(), strict=True)  # C's hypot, as NumPy's
        return float(max((abs(complex(x, y)) + half for (x, y, _), half in ends), default=0.0))


@immutable
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
