"""Arrays into which the extraction of a scan writes its lines and corners."""

from __future__ import annotations

from typing import NamedTuple

from .types import Flags, Floats, Integers


class FeatureBuffers(NamedTuple):
    """Arrays for the extracted features, one row each.

    lines            u, v, Cuu, Cuv, Cuv, Cvv, start x, y, end x, y, chi2, variance of the end's bearing
    spans            first beam, last beam, rays used, first ray, last ray (see rays)
    curved           true if a line is a chord of a curved surface
    corners          of two neighbouring lines: x, y, Cxx, Cxy, Cxy, Cyy, evidence against a curve (see curves)
    pairs            line before, line after, of each row of `corners`
    noise            of a long segment: the values of a NoiseEstimate
    """

    lines: Floats
    spans: Integers
    curved: Flags
    corners: Floats
    pairs: Integers
    noise: Floats


class NoiseEstimate(NamedTuple):
    """Estimate of the noise from the long segments of one scan.

    A weight is the number of segments that determine the variance before it, less the shares of other noise; if it is
    zero, the variance is NaN.

    segmentation_variance  squared metres: range variance if the bearing noise is as given
    range_variance         squared metres, estimated together with the bearing variance
    bearing_variance       squared radians
    """

    segmentation_variance: float
    segmentation_weight: float
    range_variance: float
    range_weight: float
    bearing_variance: float
    bearing_weight: float
