"""Running means of the noise that scans show."""

from __future__ import annotations

import math

from .feature_buffers import NoiseEstimate
from .types import LearnedNoise, Noise

# Metres. Minimum of the adapted range noise; no lidar of a robot is better, simulations often are.
# Origin: chosen; not measured.
MIN_SIGMA_RANGE = 0.002
# Metres. Maximum of the adapted range noise. Origin: chosen; not measured.
MAX_SIGMA_RANGE = 0.10
# Radians. Limits of the adapted bearing noise. Origin: encoders of robots' lidars resolve about 0.01 degrees; the
# maximum is chosen: beams of sparse lidars are a degree wide.
MIN_SIGMA_BEARING, MAX_SIGMA_BEARING = math.radians(0.005), math.radians(1.0)
# Scans. Weight of the given range noise relative to observed scans. Origin: chosen; not measured.
PRIOR_SCANS = 2.0
# Lines of a scan that determine the noise as well as it is given: surfaces differ in roughness.
# Origin: chosen; not measured.
PRIOR_LINES = 10
# Lines that determine the bearing noise as well as it is given. Origin: definition, data sheets rarely state it, so its
# variance may be wrong by as much as itself; a line's estimate has that standard deviation.
PRIOR_BEARING_LINES = 1.0
# Minimum weight of a new scan in the running mean of the range variance: a memory of about 30 scans.
# Origin: chosen; not measured.
MIN_GAIN = 0.03
# Lines in the memory of the running mean of the bearing variance. Origin: definition, as many scans of PRIOR_LINES.
MEMORY_LINES = PRIOR_LINES / MIN_GAIN


def given_noise(noise: Noise) -> LearnedNoise:
    """Return the noise that is assumed for the first scan, if `noise` is given."""
    return LearnedNoise(noise.sigma_range, noise.sigma_bearing, noise.sigma_range, PRIOR_SCANS, PRIOR_BEARING_LINES)


def updated(noise: LearnedNoise, estimate: NoiseEstimate) -> LearnedNoise:
    """Return the running mean of the noise after one more scan."""
    if not estimate.segmentation_weight > 0.0:
        return noise
    gain = max(1.0 / (noise.scans + 1.0), MIN_GAIN)
    segmentation_range = _range_mean(noise.segmentation_range, estimate.segmentation_variance, gain)
    sigma_range = noise.sigma_range
    if estimate.range_weight > 0.0:
        sigma_range = _range_mean(sigma_range, estimate.range_variance, gain)
    sigma_bearing, lines = noise.sigma_bearing, noise.lines
    if estimate.bearing_weight > 0.0:
        lines = min(lines + estimate.bearing_weight, MEMORY_LINES)
        sigma_bearing = _bearing_mean(sigma_bearing, estimate.bearing_variance, estimate.bearing_weight / lines)
    scans = min(noise.scans + 1.0, 1.0 / MIN_GAIN)
    return LearnedNoise(sigma_range, sigma_bearing, segmentation_range, scans, lines)


def _range_mean(sigma: float, variance: float, gain: float) -> float:
    """Return the root of the geometric mean of two range variances, sigma^2 and one with the weight `gain`."""
    limited = min(max(variance, MIN_SIGMA_RANGE**2), MAX_SIGMA_RANGE**2)
    return float(sigma ** (1.0 - gain) * limited ** (0.5 * gain))


def _bearing_mean(sigma: float, variance: float, gain: float) -> float:
    """Return the root of the mean of two bearing variances, sigma^2 and one with the weight `gain`.

    It is no geometric mean, as estimates may be negative where the range noise is larger.
    """
    mean = sigma * sigma + min(1.0, gain) * (variance - sigma * sigma)
    return math.sqrt(min(max(mean, MIN_SIGMA_BEARING**2), MAX_SIGMA_BEARING**2))
