"""Build the feature extractor from the configuration."""

from __future__ import annotations

from drivers.compiled import is_cached
from features import Extractor, Noise
from features.extract import MIN_GAIN, PRIOR_SCANS
from features.kernel import extract_features

from ..config import FeatureConfig, LidarConfig


def build_extractor(lidar: LidarConfig, features: FeatureConfig, sigma_range: float | None = None) -> Extractor:
    """Return the extractor for the scans of a lidar, by the configured methods.

    `sigma_range` is the standard deviation of a range (metres) if earlier scans have determined it.
    """
    learned = lidar.adapt_noise and sigma_range is not None
    return Extractor(
        Noise(sigma_range if learned and sigma_range is not None else lidar.sigma_range, lidar.sigma_bearing),
        prior_scans=1.0 / MIN_GAIN if learned else PRIOR_SCANS,
        method=features.segmentation,
        estimator=features.estimator,
        adapt_noise=lidar.adapt_noise,
        range_min=lidar.range_min,
        range_max=lidar.range_max,
    )


def is_compiled() -> bool:
    """Return False before the first compilation after an installation, when no compiled function is on disk."""
    return is_cached(extract_features)
