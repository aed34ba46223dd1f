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
    range_variances  estimates from long segments, sorted
    """

    lines: Floats
    spans: Integers
    curved: Flags
    corners: Floats
    pairs: Integers
    range_variances: Floats
