"""Build the feature extractor from the configuration."""

from __future__ import annotations

from features import Extractor, LearnedNoise, Noise
from features.kernel import extract_features
from kernel_cache import is_cached

from ..config import FeatureConfig, LidarConfig


def build_extractor(lidar: LidarConfig, features: FeatureConfig, learned: LearnedNoise | None = None) -> Extractor:
    """Return the extractor for the scans of a lidar, by the configured methods.

    `learned` is the noise of a ray if earlier scans have determined it.
    """
    return Extractor(
        Noise(lidar.sigma_range, lidar.sigma_bearing),
        learned=learned,
        method=features.segmentation,
        estimator=features.estimator,
        adapt_noise=lidar.adapt_noise,
        range_min=lidar.range_min,
        range_max=lidar.range_max,
    )


def is_compiled() -> bool:
    """Return False before the first compilation after an installation, when no compiled function is on disk."""
    return is_cached(extract_features)
