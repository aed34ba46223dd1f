"""Estimate of the wall roughness from the residuals of segments about their walls.

A line fitted to a hundred rays has a computed accuracy of a millimetre; plaster, skirting boards, rock and systematic
errors of the lidar are worse, in some buildings more than in others. So each segment of a scan is compared with its
wall at the pose that the other segments of the scan determine. At the pose by all of them, or by the scan's points,
which are on the same walls, it would seem to fit better than it does. What the covariances of segment, wall and pose do
not explain is the roughness.

Equations: docs/mathematics.md#wall-roughness.
"""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.compiled import compiled
from drivers.small_matrices import inverse, product, quadratic_form

from ..geometry.angles import wrap_angle
from ..geometry.median import weighted_median
from ..geometry.normal_distribution import NORMAL_MEDIAN
from ..geometry.roughness import Roughness, wall_weights
from ..geometry.segments import Floats, Integers, Segments
from .local_map import LocalMap

# Latest observations used: some hundred keyframes. Origin: chosen, follows a change of building; not measured.
MAX_ROUGHNESS_SAMPLES = 1000
# Square metres, assumed before observations. Small, as it stays in the factors of the first keyframes, which fix the
# map's frame. Origin: tuned on simulated drives: with larger values the covariances were too pessimistic.
INITIAL_VARIANCE = 0.0003**2
# Observations from which on the initial variance has no weight. Origin: tuned on simulated drives: with more, the
# roughness was learned too late for consistent covariances.
FULL_WEIGHT_SAMPLES = 200
# Keyframes that must have observed a wall before residuals about it are used for the wall roughness.
# Origin: chosen, the wall's own error must be small; not measured.
MIN_OBSERVATIONS_FOR_ROUGHNESS = 4


class WallRoughness:
    """Wall roughness, estimated from the residuals of segments about their walls.

    samples    (n, 2, 2) of the variances of offsets and of ends, m^2: the excess of a squared residual over what is
               expected without roughness, and what is expected
    variances  estimate
    """

    def __init__(self) -> None:
        self.samples: Floats = np.zeros((0, 2, 2))
        self.variances = Roughness(INITIAL_VARIANCE, INITIAL_VARIANCE)

    @classmethod
    def restored(cls, samples: Floats, variances: Roughness | None) -> WallRoughness:
        """Return a saved estimate. Its variances depend on those before: without them they are estimated anew."""
        roughness = cls()
        roughness.add_samples(samples)
        if variances is not None:
            roughness.variances = variances
        return roughness

    def add_samples(self, samples: Floats) -> None:
        """Add `samples` (n, 2, 2), and estimate the variances again.

        With few samples, the initial variances have weight.
        """
        self.samples = np.concatenate([self.samples, samples])[-MAX_ROUGHNESS_SAMPLES:]
        if len(self.samples):
            weight = min(1.0, len(self.samples) / FULL_WEIGHT_SAMPLES)
            offset, ends = (
                weight * _estimate(excess, expected, variance) + (1 - weight) * INITIAL_VARIANCE
                for (excess, expected), variance in zip(self.samples.transpose(1, 2, 0), self.variances, strict=True)
            )
            self.variances = Roughness(offset, ends)

    def add_scan(self, pose: se2.Pose, segments: Segments, local_map: LocalMap, rows: Integers) -> None:
        """Update the estimate with the segments of a scan, compared with well-observed walls.

        pose  of the base in the map by the scan, near which the equations are linearised
        rows  (n,) rows of the local map of the walls that the segments belong to, negative for none
        """
        matched = np.flatnonzero(rows >= 0)
        matched = matched[local_map.observations[rows[matched]] >= MIN_OBSERVATIONS_FOR_ROUGHNESS]
        if len(matched):
            walls, half_lengths = rows[matched], segments.half_length[matched]
            residuals, expected = _residuals_by_others(
                pose, segments.frame[matched], half_lengths, segments.covariance[matched],
                local_map.frame[walls], local_map.wall_covariance[walls], tuple(self.variances),
            )  # fmt: skip
            samples = np.stack([residuals**2 / NORMAL_MEDIAN - expected, expected], axis=-1)
            samples[:, 1] *= half_lengths[:, None] ** 2 / 3  # of ends instead of headings
            self.add_samples(samples)


def _estimate(excess: Floats, expected: Floats, variance: float) -> float:
    """Return the median excess (n,) of squared residuals, on which wrong associations have little influence.

    The weight of each is its information on the variance, 1 / (2 v^2) for a normal variable of variance v, up to a
    factor. Its v is what was `expected` (n,) without roughness, and the `variance` that was estimated before.
    """
    information = (expected + variance) ** -2.0
    return max(0.0, weighted_median(excess, information))


@compiled
def _residuals_by_others(  # type: ignore[no-untyped-def]
    pose, frames, halves, covariances, walls, wall_covariances, roughness
):
    """Return offsets and headings (n, 2) of segments at their walls, at the pose by the others, and their variances.

    pose              (3,) of the base in the map, near which the equations are linearised
    frames            (n, 3) of the segments in the base's frame
    halves            (n,) half the lengths of the segments, metres
    covariances       (n, 2, 2) of offset and heading of the segments
    walls             (n, 3) in the map
    wall_covariances  (n, 2, 2) of offset and heading at a wall's frame
    roughness         variances (2,) of the others; the variances that are returned are without it
    """
    count = len(frames)
    residuals, variances, slopes = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 3))
    information, gradients = np.empty((count, 3, 3)), np.empty((count, 3))
    for k in range(count):
        c, s, wall = math.cos(walls[k, 2]), math.sin(walls[k, 2]), wall_covariances[k]
        x, y = pose[0] - walls[k, 0], pose[1] - walls[k, 1]
        x, y, turn = c * x + s * y, c * y - s * x, pose[2] - walls[k, 2]
        c, s = math.cos(turn), math.sin(turn)
        lever, across = c * frames[k, 0] - s * frames[k, 1], s * frames[k, 0] + c * frames[k, 1]
        offset, heading = y + across, wrap_angle(turn + frames[k, 2])
        residuals[k, 0], residuals[k, 1] = offset, heading
        slopes[k, 0], slopes[k, 1], slopes[k, 2] = s, c, lever  # of the offset by the pose
        along = x + lever
        variances[k, 0] = covariances[k, 0, 0] + wall[0, 0] + along * (2.0 * wall[0, 1] + along * wall[1, 1])
        variances[k, 1] = covariances[k, 1, 1] + wall[1, 1]
        yy, yt, tt = wall_weights(covariances[k], halves[k], wall, along, roughness)
        for i in range(3):
            turned = 1.0 if i == 2 else 0.0  # slope of the heading
            by_offset, by_heading = slopes[k, i] * yy + turned * yt, slopes[k, i] * yt + turned * tt
            gradients[k, i] = by_offset * offset + by_heading * heading
            for j in range(3):
                information[k, i, j] = by_offset * slopes[k, j] + (by_heading if j == 2 else 0.0)
    total, gradient = np.eye(3) + information.sum(axis=0), gradients.sum(axis=0)  # known to a metre and a radian
    for k in range(count):
        covariance, slope = inverse(total - information[k]), slopes[k]
        moved = product(covariance, gradient - gradients[k])
        residuals[k, 0] -= slope[0] * moved[0] + slope[1] * moved[1] + slope[2] * moved[2]
        residuals[k, 1] -= moved[2]
        variances[k, 0] += quadratic_form(covariance, slope[0], slope[1], slope[2])
        variances[k, 1] += covariance[2, 2]
    return residuals, variances
