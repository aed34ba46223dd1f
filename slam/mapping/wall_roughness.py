"""Wall roughness: deviation of real walls from a straight line, beyond the propagated noise of the rays.

A line fitted to a hundred rays has a computed accuracy of a millimetre; plaster, skirting boards and systematic errors
of the lidar are worse, in some buildings more than in others. So the scatter of observations about their walls is
measured while driving, and what the propagated covariance does not explain is added to it. Roughness of variance f at
either end of a segment of length l adds the variance f to its offset and 12 f / l^2 to its heading.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers, Segments

# Latest samples used, two per observation: some fifty keyframes. Origin: chosen, follows a change of building; not
# measured.
MAX_ROUGHNESS_SAMPLES = 1000
# Square metres, assumed before observations. Small, as it stays in the factors of the first keyframes, which fix the
# map's frame. Origin: tuned on simulated drives: with larger values the covariances were too pessimistic.
INITIAL_VARIANCE = 0.0003**2
# Samples from which on the initial variance has no weight. Origin: tuned on simulated drives: with more, the roughness
# was learned too late for consistent covariances.
FULL_WEIGHT_SAMPLES = 200
# Keyframes that must have observed a wall before residuals about it are used for the wall roughness.
# Origin: chosen, the wall's own error must be small; not measured.
MIN_OBSERVATIONS_FOR_ROUGHNESS = 4
# Median of a squared standard normal variable. Origin: definition, chi-square, 1 dof.
NORMAL_MEDIAN = 0.4549


class WallRoughness:
    """Variance of the wall roughness (square metres), estimated from the residuals of associated segments."""

    def __init__(self) -> None:
        self._samples: Floats = np.zeros(0)
        self.variance = INITIAL_VARIANCE

    @property
    def samples(self) -> Floats:
        """(n,) samples of the variance, from which it is estimated."""
        return self._samples

    def add_samples(self, samples: Floats) -> None:
        """Add `samples` (n,), e.g. of a saved estimate, and estimate the variance again."""
        self._samples = np.concatenate([self._samples, samples])[-MAX_ROUGHNESS_SAMPLES:]
        self._estimate()

    def add_residuals(self, residuals: Floats, covariances: Floats, half_lengths: Floats) -> None:
        """Update the estimate with residuals of segments about their walls.

        residuals     (n, 2) of offset and heading
        covariances   (n, 2, 2) expected of them without roughness
        half_lengths  (n,) metres

        Each residual gives a sample: the variance in excess of its covariance, converted to a variance of the wall's
        points. The estimate is their median, which wrong associations do not affect; dividing by NORMAL_MEDIAN makes
        it consistent.
        """
        excess = residuals**2 / NORMAL_MEDIAN - np.diagonal(covariances, axis1=1, axis2=2)
        excess[:, 1] *= half_lengths**2 / 3
        self.add_samples(excess.ravel())

    def add_observations(self, walls: NDArray[np.void], pose: se2.Pose, segments: Segments, ids: Integers) -> None:
        """Update the estimate with the residuals of a keyframe's segments about well-observed walls.

        walls  rows of all walls in the landmark table
        pose   of the keyframe in the map
        ids    (n,) walls that the segments belong to, -1 for none
        """
        matched = np.flatnonzero(ids >= 0)
        matched = matched[walls["observations"][ids[matched]] >= MIN_OBSERVATIONS_FOR_ROUGHNESS]
        if not len(matched):
            return
        residuals = se2.between(walls["frame"][ids[matched]], se2.compose(pose, segments.frame[matched]))
        self.add_residuals(residuals[:, 1:], segments.covariance[matched], segments.half_length[matched])

    def _estimate(self) -> None:
        if not len(self._samples):
            return
        observed = max(0.0, float(np.median(self._samples)))
        weight = min(1.0, len(self._samples) / FULL_WEIGHT_SAMPLES)
        self.variance = weight * observed + (1 - weight) * INITIAL_VARIANCE


def add_roughness(covariances: Floats, half_lengths: Floats, variance: float) -> Floats:
    """Return the covariances (n, 2, 2) of offset and heading with the variance (m^2) of the wall roughness added."""
    result = covariances.copy()
    result[:, 0, 0] += variance
    result[:, 1, 1] += 3 * variance / half_lengths**2
    return result
