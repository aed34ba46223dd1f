"""Wall roughness: deviation of real walls from a straight line, beyond the propagated noise of the rays.

A line fitted to a hundred rays has a computed accuracy of a millimetre; plaster, skirting boards, rock and systematic
errors of the lidar are worse, in some buildings more than in others. So segments are compared with their walls while
driving, at the pose that the scan's points determine: the pose by the walls themselves follows their errors. What the
covariances of segment, wall and pose do not explain is added to the segments'. Roughness of variance f at either end
of a segment of length l adds the variance f to its offset and 12 f / l^2 to its heading.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled

from ..geometry.angles import wrap_angle
from ..geometry.median import median
from ..geometry.normal_distribution import NORMAL_MEDIAN
from ..geometry.segments import Floats, Integers, Segments
from ..geometry.small_matrices import quadratic_form
from .local_map import LocalMap

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

    def add_scan(
        self, pose: se2.Pose, covariance: Floats, segments: Segments, local_map: LocalMap, rows: Integers
    ) -> None:
        """Update the estimate with the segments of a scan, compared with well-observed walls.

        pose        of the base in the map by the scan's points, with its `covariance` (3, 3) in the base's frame
        rows        (n,) rows of the local map of the walls that the segments belong to, negative for none
        """
        matched = np.flatnonzero(rows >= 0)
        matched = matched[local_map.observations[rows[matched]] >= MIN_OBSERVATIONS_FOR_ROUGHNESS]
        if len(matched):
            frames, walls = segments.frame[matched], rows[matched]
            residuals, expected = _residuals(
                pose, covariance, frames, local_map.frame[walls], local_map.wall_covariance[walls]
            )
            self.add_residuals(residuals, segments.covariance[matched] + expected, segments.half_length[matched])

    def _estimate(self) -> None:
        if not len(self._samples):
            return
        observed = max(0.0, float(median(self._samples)))
        weight = min(1.0, len(self._samples) / FULL_WEIGHT_SAMPLES)
        self.variance = weight * observed + (1 - weight) * INITIAL_VARIANCE


@compiled
def _residuals(pose, covariance, frames, walls, wall_covariances):  # type: ignore[no-untyped-def]
    """Return offsets and headings (n, 2) of segments at their walls, and their covariances (n, 2, 2) by pose and wall.

    pose, covariance  (3,) of the base in the map, (3, 3) in its own frame
    frames            (n, 3) of the segments in the base's frame
    walls             (n, 3) in the map
    wall_covariances  (n, 2, 2) of offset and heading at a wall's frame
    """
    count = len(frames)
    residuals, expected = np.empty((count, 2)), np.empty((count, 2, 2))
    for k in range(count):
        turn = pose[2] - walls[k, 2]
        c, s = math.cos(walls[k, 2]), math.sin(walls[k, 2])
        x, y = c * (pose[0] - walls[k, 0]) + s * (pose[1] - walls[k, 1]), c * (pose[1] - walls[k, 1])
        y -= s * (pose[0] - walls[k, 0])
        c, s = math.cos(turn), math.sin(turn)
        along, across = c * frames[k, 0] - s * frames[k, 1], s * frames[k, 0] + c * frames[k, 1]
        residuals[k, 0], residuals[k, 1] = y + across, wrap_angle(turn + frames[k, 2])
        # The derivatives of the offset are (s, c, along) by the pose, and (1, lever) by offset and heading of the wall.
        lever, wall = x + along, wall_covariances[k]
        at_wall = wall[0, 1] + lever * wall[1, 1]
        mixed = s * covariance[0, 2] + c * covariance[1, 2] + along * covariance[2, 2] + at_wall
        expected[k, 0, 0] = quadratic_form(covariance, s, c, along) + wall[0, 0] + lever * (wall[0, 1] + at_wall)
        expected[k, 0, 1] = expected[k, 1, 0] = mixed
        expected[k, 1, 1] = covariance[2, 2] + wall[1, 1]
    return residuals, expected


def add_roughness(covariances: Floats, half_lengths: Floats, variance: float) -> Floats:
    """Return the covariances (n, 2, 2) of offset and heading with the variance (m^2) of the wall roughness added."""
    result = covariances.copy()
    result[:, 0, 0] += variance
    result[:, 1, 1] += 3 * variance / half_lengths**2
    return result
