"""Build the feature extractor from the configuration."""

from __future__ import annotations

import logging
from functools import cache

from features import Extractor, LearnedNoise, Noise
from features.kernel import extract_features
from kernel_cache import is_cached

from ..config import FeatureConfig, LidarConfig

COMPILING = (
    "compiling, once after an installation or update; scans wait meanwhile, for up to a minute. slam.warm_up() does it "
    "before a drive"
)
_logger = logging.getLogger(__name__)


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


@cache
def warn_of_compilation() -> None:
    """Log a warning if what comes next compiles for long; once in a process. Commands print another message."""
    if not is_compiled():
        _logger.warning(COMPILING)
