"""Build the feature extractor from the configuration."""

from __future__ import annotations

from features import Extractor, Noise
from features.extract import MIN_GAIN, PRIOR_SCANS

from ..config import Config


def build_extractor(config: Config, sigma_range: float | None = None) -> Extractor:
    """Return the extractor for the configured lidar and methods.

    `sigma_range` is the standard deviation of a range (metres) if earlier scans have determined it.
    """
    lidar = config.lidar
    learned = lidar.adapt_noise and sigma_range is not None
    return Extractor(
        Noise(sigma_range if learned and sigma_range is not None else lidar.sigma_range, lidar.sigma_bearing),
        prior_scans=1.0 / MIN_GAIN if learned else PRIOR_SCANS,
        method=config.features.segmentation,
        estimator=config.features.estimator,
        adapt_noise=lidar.adapt_noise,
        range_min=lidar.range_min,
        range_max=lidar.range_max,
    )
