"""Removal of the estimated range bias from the features of a scan."""

from __future__ import annotations

from dataclasses import replace

from ..geometry.range_bias import without_range_bias
from .line_matcher import ScanFeatures


def correct_range_bias(features: ScanFeatures, bias: float) -> ScanFeatures:
    """Return the features of a scan as if all its ranges were shorter by `bias` metres; its points stay as they are.

    Points are matched to points of earlier scans, which have the same bias.
    """
    if not bias:
        return features
    segments, corners = without_range_bias(features.segments, features.corners, bias)
    return replace(features, segments=segments, corners=corners)
