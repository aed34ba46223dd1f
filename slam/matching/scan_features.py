"""Features of one scan, as they are registered and stored: segments, corners and points in the base's frame."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from drivers.immutable import immutable

from ..geometry.range_bias import without_range_bias
from ..geometry.segments import CornerPoints, Floats, Segments
from .point_matcher import POINT_SPACING
from .scan_points import ScanPoints, surface_points


@immutable
class ScanFeatures:
    """Features of one scan, in the base's frame.

    sweep_covariance  (3, 3) of the scan's pose relative to that of the base, by errors of odometry during the sweep:
                      metres and radians, see `slam.preprocessing.motion_uncertainty`
    """

    segments: Segments
    corners: CornerPoints
    points: ScanPoints
    sweep_covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))

    def surface_points(self) -> Floats:
        """Return the points (q, 6) that are matched, with normals, see `scan_points.surface_points`."""
        return surface_points(self.points.xy, self.segments, POINT_SPACING, self.points.sigma)

    def without_range_bias(self, bias: float) -> ScanFeatures:
        """Return the features as if all ranges were shorter by `bias` metres; the points stay as they are.

        Points are matched to points of earlier scans, which have the same bias.
        """
        if not bias:
            return self
        segments, corners = without_range_bias(self.segments, self.corners, bias)
        return ScanFeatures(segments, corners, self.points, self.sweep_covariance)
