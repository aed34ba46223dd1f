"""How flat the building's walls are: what real walls add to the noise that was propagated from the rays.

A fit to a hundred rays claims a millimetre; plaster, skirting boards and the lidar's own systematic errors are worse
than that, in some buildings more than in others. So the scatter of observations about their walls is watched while
driving, and what the propagated covariance does not explain is added to it: unevenness of variance f at either end
of a segment of length l moves it by f across and turns it by 12 f / l^2 (both variances).
"""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats

WINDOW = 1000  # numbers, two an observation: some fifty keyframes
# Metres squared; assumed at first. Little, for what is assumed stays with the first keyframes, on which the map hangs.
START = 0.0003**2
ENOUGH = 200  # numbers after which only what was seen counts
NORMAL_MEDIAN = 0.4549  # median of a squared standard normal variable


class WallRoughness:
    """Variance of the walls' unevenness (metres squared), estimated from the residuals of associated segments."""

    def __init__(self) -> None:
        self._samples: Floats = np.zeros(0)
        self.variance = START

    @property
    def samples(self) -> Floats:
        """(n,) what the estimate rests on; `add_samples` has them again."""
        return self._samples

    def add_samples(self, samples: Floats) -> None:
        """Go on from what another estimate rested on."""
        self._samples = np.concatenate([self._samples, samples])[-WINDOW:]
        self._estimate()

    def add_residuals(self, residuals: Floats, covariances: Floats, half_lengths: Floats) -> None:
        """Take residuals (n, 2) of offset and heading, the covariances (n, 2, 2) expected of them without unevenness.

        The variance that brings the median of the squared residuals to its expectation is found from the excess of each
        sample; the median is deaf to wrong associations.
        """
        excess = residuals**2 / NORMAL_MEDIAN - np.diagonal(covariances, axis1=1, axis2=2)
        excess[:, 1] *= half_lengths**2 / 3
        self.add_samples(excess.ravel())

    def _estimate(self) -> None:
        if not len(self._samples):
            return
        observed = max(0.0, float(np.median(self._samples)))
        trust = min(1.0, len(self._samples) / ENOUGH)
        self.variance = trust * observed + (1 - trust) * START


def add_roughness(covariances: Floats, half_lengths: Floats, variance: float) -> Floats:
    """Covariances (n, 2, 2) of offset and heading with the walls' unevenness added."""
    result = covariances.copy()
    result[:, 0, 0] += variance
    result[:, 1, 1] += 3 * variance / half_lengths**2
    return result
