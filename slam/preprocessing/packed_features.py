"""Features of a scan in one array: with an array for each quantity, the arrays' overhead is larger than the numbers."""

from __future__ import annotations

import numpy as np

from ..geometry.segments import CornerPoints, Floats, Segments
from ..matching.scan_features import ScanFeatures

# Numbers of a segment (frame, half length, covariance, bias slope), of a corner (position, covariance, segments,
# headings), and of a sweep covariance. Origin: definition.
SEGMENT_NUMBERS, CORNER_NUMBERS, SWEEP_NUMBERS = 10, 10, 9


class PackedFeatures:
    """Features of a scan in little memory. The `points` are shared: `ScanPoints` are small already."""

    __slots__ = ("_numbers", "_segment_count", "points")

    def __init__(self, features: ScanFeatures) -> None:
        segments, corners = features.segments, features.corners
        self._segment_count, self.points = len(segments), features.points
        arrays = (
            segments.frame, segments.half_length, segments.covariance, segments.bias_slope,
            corners.position, corners.covariance, corners.segments, corners.headings,
            features.sweep_covariance,
        )  # fmt: skip
        self._numbers: Floats = np.concatenate([array.ravel() for array in arrays], dtype=np.float64)

    def unpack(self) -> ScanFeatures:
        """Return the features, as views that must not be changed."""
        n, numbers = self._segment_count, self._numbers
        of_segments, of_corners = numbers[: SEGMENT_NUMBERS * n], numbers[SEGMENT_NUMBERS * n : -SWEEP_NUMBERS]
        m = len(of_corners) // CORNER_NUMBERS
        segments = Segments(
            of_segments[: 3 * n].reshape(n, 3),
            of_segments[3 * n : 4 * n],
            of_segments[4 * n : 8 * n].reshape(n, 2, 2),
            of_segments[8 * n :].reshape(n, 2),
        )
        corners = CornerPoints(
            of_corners[: 2 * m].reshape(m, 2),
            of_corners[2 * m : 6 * m].reshape(m, 2, 2),
            of_corners[6 * m : 8 * m].reshape(m, 2).astype(np.int64),
            of_corners[8 * m :].reshape(m, 2),
        )
        return ScanFeatures(segments, corners, self.points, numbers[-SWEEP_NUMBERS:].reshape(3, 3))
