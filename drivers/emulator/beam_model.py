"""Beam model: the ranges that a turning lidar measures from the moving robot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..messages import Floats
from ..se2 import Pose
from ..simulation.lidar_model import LidarModel, add_mixed_pixels
from .robot_motion import RobotMotion

MAX_LAG_ITERATIONS = 3
"""Iterations for the direction of a beam that is corrected by its own range; if it does not converge, as at edges, the
beam has no return.
"""
LAG_TOLERANCE = 1e-3
"""Radians by which the direction may still have changed in the last iteration."""


class BeamModel:
    """Beams cast into the world, with a lidar's noise.

    mount  [x, y, heading] on the robot
    noise  of the beams, and the limits of range
    """

    def __init__(self, motion: RobotMotion, mount: Pose, noise: LidarModel, random: np.random.Generator) -> None:
        self._motion, self._mount, self._noise, self._random = motion, mount, noise, random

    def measure(self, times: Floats, bearings: Floats) -> Floats:
        """Return ranges (n,) along bearings (n,) in the lidar's frame at times (n,), NaN for no return; n >= 2.

        The beams are neighbours: one beside an edge may return a range between the two surfaces.
        """
        noise = self._noise
        # Whether a beam is at an edge depends on one beam before it and two after it.
        times, bearings = _extended(times), _extended(bearings)
        aimed = bearings + noise.sigma_bearing * self._random.standard_normal(len(bearings))
        ranges = self._motion.cast_beams(times, aimed, self._mount)
        mixed, share, dropped = self._random.random((3, len(ranges)))
        add_mixed_pixels(ranges, mixed < noise.mixed, share)
        ranges += noise.sigma_range * self._random.standard_normal(len(ranges))
        ranges[~((ranges >= noise.range_min) & (ranges <= noise.range_max)) | (dropped < noise.dropouts)] = np.nan
        return ranges[1:-2]

    def measure_with_lag(
        self, times: Floats, heads: Floats, lag_of: Callable[[Floats], Floats]
    ) -> tuple[Floats, Floats]:
        """Return ranges (n,), and radians (n,) by which beams lag the head, of a triangulating lidar that turns
        clockwise.

        heads   (n,) radians clockwise
        lag_of  function from ranges (n,) to lags (n,), radians
        """
        lags = lag_of(np.full(len(heads), np.inf))
        for _ in range(MAX_LAG_ITERATIONS):
            lags, last = lag_of(self._motion.cast_beams(times, lags - heads, self._mount)), lags
        ranges = self.measure(times, lags - heads)
        ranges[np.abs(lags - last) > LAG_TOLERANCE] = np.nan
        return ranges, lags


def _extended(values: Floats) -> Floats:
    """Return values (n,) extrapolated by one before and two after them; n >= 2."""
    first, last = values[1] - values[0], values[-1] - values[-2]
    return np.concatenate([[values[0] - first], values, [values[-1] + last, values[-1] + 2 * last]])
