"""Lines and corners of 2-D lidar scans, with covariances.

extractor = Extractor(Noise(sigma_range=0.01, sigma_bearing=0.002))
features = extractor.extract(ranges, angles)
features.lines.uv, features.corners.position
"""

from .extract import Extractor
from .types import Corners, Features, Lines, Noise

__all__ = ["Corners", "Extractor", "Features", "Lines", "Noise"]
