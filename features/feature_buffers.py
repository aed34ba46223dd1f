"""Arrays into which the extraction of a scan writes its lines and corners."""

from __future__ import annotations

from typing import NamedTuple

from .types import Flags, Floats, Integers


class FeatureBuffers(NamedTuple):
    """Arrays for the extracted features, one row each.

    lines            u, v, Cuu, Cuv, Cuv, Cvv, start x, y, end x, y, chi2, variance of the end's bearing
    spans            first beam, last beam, rays used, first ray, last ray (see rays)
    curved           true if a line is a chord of a curved surface
    corners          x, y, Cxx, Cxy, Cxy, Cyy, evidence against a curve (see curves)
    pairs            line before, line after
    noise            range variance and its weight, bearing variance and its weight, as estimated from a long segment
    """

    lines: Floats
    spans: Integers
    curved: Flags
    corners: Floats
    pairs: Integers
    noise: Floats


class NoiseEstimate(NamedTuple):
    """Estimate of the noise from the long segments of one scan.

    range_variance    squared metres; NaN if there is no such segment
    range_weight      number of segments that determine it, less the shares of other noise
    bearing_variance  squared radians; NaN if there is no such segment
    bearing_weight    as range_weight
    """

    range_variance: float
    range_weight: float
    bearing_variance: float
    bearing_weight: float
