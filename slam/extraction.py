"""The extractor of features as it is configured."""

from __future__ import annotations

from features import Extractor, Noise

from .config import Config


def build_extractor(config: Config) -> Extractor:
    """The extractor for the lidar and the methods that are configured."""
    lidar = config.lidar
    return Extractor(
        Noise(lidar.sigma_range, lidar.sigma_bearing),
        method=config.features.segmentation,
        estimator=config.features.estimator,
        adapt_noise=lidar.adapt_noise,
        range_min=lidar.range_min,
        range_max=lidar.range_max,
    )
