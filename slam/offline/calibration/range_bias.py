"""An error that all ranges of a lidar have in common, from what it does to walls.

Ranges that are too long by b put a wall at distance d farther away by b where it is met head-on, and by less where it
is met at an angle: the wall comes out bent. Its residuals r_i, in 1/range, follow b through dr_i/db = -p_i^2 (p_i the
predicted 1/range), of which the fitted line has taken what a line can take. What is left, g_i, gives

    b = sum w_i g_i r_i / sum w_i g_i^2

over all rays of all walls. Common to all rays of a scan, and of all scans, the error does not average out over rays: it
is no noise of a wall, and belongs to the lidar's calibration.
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

FEWEST_RAYS = 15
"""Of a wall that is asked; shorter ones cannot show how they are bent."""
GATE = 16.0
"""Largest squared normalised residual of a ray that is asked: four standard deviations."""
FEWEST_SCANS = 20
"""For an estimate with a standard error."""
ROUNDS = 2
"""Times that a drive is looked at; at first the gate leaves out rays of walls that are bent much against the noise."""


class RangeBias:
    """Gathers what scans say of the common error of their ranges."""

    def __init__(self) -> None:
        self._scans: list[tuple[float, float]] = []  # of each scan: sum w g r and sum w g^2

    def add(self, ranges: Floats, bearings: Floats, features: Features) -> None:
        """Take a scan: ranges (n,) in metres and bearings (n,) in radians, and what was extracted from them."""
        lines = features.lines
        score = information = 0.0
        for uv, first, last, count, curved in zip(
            lines.uv, lines.first, lines.last, lines.count, lines.curved, strict=True
        ):
            if count < FEWEST_RAYS or curved:
                continue
            rays = np.arange(first + 1, last + (len(ranges) if last < first else 0)) % len(ranges)
            of_line = self._of_line(ranges[rays], bearings[rays], uv, features)
            score, information = score + of_line[0], information + of_line[1]
        if information > 0.0:
            self._scans.append((score, information))

    @staticmethod
    def _of_line(ranges: Floats, bearings: Floats, uv: Floats, features: Features) -> tuple[float, float]:
        """Sum w g r and sum w g^2 of one wall's rays."""
        noise = features.noise
        valid = np.isfinite(ranges) & (ranges > 0.0)
        design = np.column_stack([np.cos(bearings[valid]), np.sin(bearings[valid])])
        inverse = 1.0 / ranges[valid]
        predicted, slope = design @ uv, design @ np.array([uv[1], -uv[0]])
        residual = inverse * (1.0 - (noise.sigma_range * inverse) ** 2) - predicted
        weight = 1.0 / ((noise.sigma_range * predicted**2) ** 2 + (noise.sigma_bearing * slope) ** 2)
        weight[weight * residual**2 > GATE] = 0.0
        if np.count_nonzero(weight) < FEWEST_RAYS:
            return 0.0, 0.0
        weighted = design * weight[:, None]
        bent = -(predicted**2)
        bent -= design @ np.linalg.solve(weighted.T @ design, weighted.T @ bent)
        return float(weight @ (bent * residual)), float(weight @ bent**2)

    def estimate(self) -> tuple[float, float]:
        """The error in metres, positive where ranges are long, and its standard error as scans scatter.

        Raises MapError where too few scans show walls.
        """
        if len(self._scans) < FEWEST_SCANS:
            raise MapError(f"{len(self._scans)} scans with walls are too few to calibrate the ranges")
        score, information = np.array(self._scans).T
        bias = score.sum() / information.sum()
        scatter = np.sqrt(np.sum((score - bias * information) ** 2))
        return float(bias), float(scatter / information.sum())


def estimate_range_bias(drive: Sequence[Message], config: Config) -> tuple[float, float]:
    """The error of all ranges of a drive, metres, and its standard error; the configured one is where it begins.

    Raises MapError where too few scans show walls.
    """
    history = OdometryHistory()
    for message in drive:
        if isinstance(message, Odometry):
            history.add(message)
    bias, sigma = config.lidar.range_bias, float("nan")
    for _ in range(ROUNDS):
        gathered, extractor = RangeBias(), build_extractor(config)
        for message in drive:
            if isinstance(message, Scan):
                sweep = deskew(message, history, lidar_mount(message, config.lidar), bias)
                gathered.add(sweep.ranges, sweep.bearings, extractor.extract(sweep.ranges, sweep.bearings))
        found, sigma = gathered.estimate()
        bias += found
    return bias, sigma
