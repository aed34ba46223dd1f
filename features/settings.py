"""Settings of the extraction, as passed to compiled functions."""

from __future__ import annotations

from typing import NamedTuple


class Settings(NamedTuple):
    """Lengths in metres, standard deviations in metres and radians; described at Extractor."""

    sigma_range: float  # of segmentation, the weights of fits, and tests
    sigma_bearing: float
    learned_range: float  # of covariances
    learned_bearing: float
    range_min: float
    range_max: float
    minimum_count: int
    minimum_length: float
    maximum_gap: float
    roughness: float
    penalty: float
    tracking_distance: float  # 0 for recursive splitting
    estimator: int  # code, see estimators
