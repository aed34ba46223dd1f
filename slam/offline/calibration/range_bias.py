"""Estimate the range bias, an error common to all ranges of a lidar, from how it bends walls.

Ranges that are too long by b move a wall at distance d by b where a beam meets it at a right angle, and by less where
it meets it at another angle: the wall is bent. Its residuals r_i in 1/range depend on b by dr_i/db = -p_i^2, with the
predicted 1/range p_i. The fitted line absorbs part of that; with the remainder g_i,

    b = sum w_i g_i r_i / sum w_i g_i^2

over all beams of all walls. The bias is common to all beams and scans and does not average out, so it is calibrated
instead of being part of a wall's noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.messages import Message, Odometry, Scan
from features import Features

from ...config import Config
from ...errors import MapError
from ...geometry.segments import Floats
from ...odometry.history import OdometryHistory
from ...preprocessing.deskew import deskew, lidar_mount
from ...preprocessing.extraction import build_extractor

MIN_BEAMS = 15
"""Beams on a wall that is used; shorter walls do not show how they are bent."""
MAX_SQUARED_RESIDUAL = 16.0
"""Squared normalised residual of a beam that is used: four standard deviations."""
MIN_SCANS = 20
"""Scans for an estimate with a standard error."""
BIAS_ITERATIONS = 2
"""Passes over a drive: in the first, the limit on residuals excludes beams of walls that are strongly bent."""


class RangeBiasEstimator:
    """Estimator of the range bias from any number of scans."""

    def __init__(self) -> None:
        self._scans: list[tuple[float, float]] = []  # of each scan: sum w g r and sum w g^2

    def add(self, ranges: Floats, bearings: Floats, features: Features) -> None:
        """Add a scan: ranges (n,) in metres, bearings (n,) in radians, and the features extracted from them."""
        lines = features.lines
        score = information = 0.0
        for uv, first, last, count, curved in zip(
            lines.uv, lines.first, lines.last, lines.count, lines.curved, strict=True
        ):
            if count < MIN_BEAMS or curved:
                continue
            beams = np.arange(first + 1, last + (len(ranges) if last < first else 0)) % len(ranges)
            of_line = self._sums_of_line(ranges[beams], bearings[beams], uv, features)
            score, information = score + of_line[0], information + of_line[1]
        if information > 0.0:
            self._scans.append((score, information))

    @staticmethod
    def _sums_of_line(ranges: Floats, bearings: Floats, uv: Floats, features: Features) -> tuple[float, float]:
        """Return sum w g r and sum w g^2 over the beams of one wall."""
        noise = features.noise
        valid = np.isfinite(ranges) & (ranges > 0.0)
        design = np.column_stack([np.cos(bearings[valid]), np.sin(bearings[valid])])
        inverse = 1.0 / ranges[valid]
        predicted, slope = design @ uv, design @ np.array([uv[1], -uv[0]])
        residual = inverse * (1.0 - (noise.sigma_range * inverse) ** 2) - predicted
        weight = 1.0 / ((noise.sigma_range * predicted**2) ** 2 + (noise.sigma_bearing * slope) ** 2)
        weight[weight * residual**2 > MAX_SQUARED_RESIDUAL] = 0.0
        if np.count_nonzero(weight) < MIN_BEAMS:
            return 0.0, 0.0
        weighted = design * weight[:, None]
        bending = -(predicted**2)
        bending -= design @ np.linalg.solve(weighted.T @ design, weighted.T @ bending)
        return float(weight @ (bending * residual)), float(weight @ bending**2)

    def estimate(self) -> tuple[float, float]:
        """Return the bias in metres, positive if ranges are too long, and its standard error from the scans' scatter.

        Raises MapError if too few scans have walls.
        """
        if len(self._scans) < MIN_SCANS:
            raise MapError(f"{len(self._scans)} scans with walls are too few to calibrate the ranges")
        score, information = np.array(self._scans).T
        bias = score.sum() / information.sum()
        scatter = np.sqrt(np.sum((score - bias * information) ** 2))
        return float(bias), float(scatter / information.sum())


def estimate_range_bias(drive: Sequence[Message], config: Config) -> tuple[float, float]:
    """Return the range bias of a drive and its standard error, metres, starting from the configured bias.

    Raises MapError if too few scans have walls.
    """
    history = OdometryHistory()
    for message in drive:
        if isinstance(message, Odometry):
            history.add(message)
    bias, sigma = config.lidar.range_bias, float("nan")
    for _ in range(BIAS_ITERATIONS):
        estimator, extractor = RangeBiasEstimator(), build_extractor(config)
        for message in drive:
            if isinstance(message, Scan):
                sweep = deskew(message, history, lidar_mount(message, config.lidar), bias)
                estimator.add(sweep.ranges, sweep.bearings, extractor.extract(sweep.ranges, sweep.bearings))
        found, sigma = estimator.estimate()
        bias += found
    return bias, sigma
