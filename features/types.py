"""Lines and corners of a scan with covariances, in the lidar's frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

# What is created for every scan is not frozen: the construction of a frozen dataclass takes five times as long.


@dataclass(frozen=True, slots=True)
class Noise:
    """Independent noise of each ray: standard deviation of range (metres) and of bearing (radians)."""

    sigma_range: float
    sigma_bearing: float


@dataclass(frozen=True, slots=True)
class LearnedNoise(Noise):
    """Noise that scans have determined: range and bearing together, for covariances.

    segmentation_range  metres: standard deviation of range that explains the scans with the given bearing noise
    scans  weight of the range noise in the running mean; infinite if not known, as of many scans
    lines  weight of the bearing noise, likewise
    """

    segmentation_range: float
    scans: float = math.inf
    lines: float = math.inf


@dataclass(slots=True, eq=False)
class Lines:
    """n fitted wall segments, in the order of their bearings.

    A line is u x + v y = 1, so (u, v) = P / |P|^2 with P its point closest to the lidar. Seen from the lidar the
    segment runs counter-clockwise from `start` to `end`; the lidar is on its left.

    uv          (n, 2) 1/metres
    covariance  (n, 2, 2) of uv, propagated from the noise of the rays
    start, end  (n, 2) metres, the end points on the fitted line
    first, last (n,) indices of the first and last ray; last < first if it crosses the end of a full revolution
    count       (n,) rays fitted
    chi2        (n,) weighted sum of squared residuals; count - 2 degrees of freedom
    curved      (n,) true if the line and a neighbour are chords of a curved surface instead of meeting in a corner
    """

    uv: Floats
    covariance: Floats
    start: Floats
    end: Floats
    first: Integers
    last: Integers
    count: Integers
    chi2: Floats
    curved: Flags

    def __len__(self) -> int:
        return len(self.uv)


@dataclass(slots=True, eq=False)
class Corners:
    """m intersections of neighbouring lines.

    position    (m, 2) metres
    covariance  (m, 2, 2)
    lines       (m, 2) indices of the lines before and after the corner, counter-clockwise
    """

    position: Floats
    covariance: Floats
    lines: Integers

    def __len__(self) -> int:
        return len(self.position)


@dataclass(slots=True, eq=False)
class Features:
    """Lines and corners of one scan, and the noise from which their covariances are propagated."""

    lines: Lines
    corners: Corners
    noise: Noise

    def without_chords(self) -> Features:
        """Return the features without chords of curved surfaces, and without the corners of these."""
        straight = ~self.lines.curved
        if straight.all():
            return self
        lines = Lines(*(getattr(self.lines, field.name)[straight] for field in fields(Lines)))
        kept, rows = straight[self.corners.lines].all(axis=1), np.cumsum(straight) - 1
        corners = Corners(self.corners.position[kept], self.corners.covariance[kept], rows[self.corners.lines[kept]])
        return replace(self, lines=lines, corners=corners)

    def _repr_svg_(self) -> str:
        """Return a drawing, for notebooks."""
        from .drawing import draw

        return draw(self)
