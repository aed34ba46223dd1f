"""How certain the poses of scans are if the base moves evenly from the scan before to the next one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.compiled import compiled
from drivers.small_matrices import inverse

from ...geometry.pose_covariance import POSE_SIGMAS
from ...geometry.segments import Floats
from ...odometry.velocity import ACCELERATIONS, MAX_VELOCITIES

# Metres, metres, radians: standard deviations of the pose, relative to its keyframe, of a scan that was tracked.
# Origin: definition.
TRACKED_SIGMAS = POSE_SIGMAS


def fractions_of(intervals: Sequence[float]) -> list[float]:
    """Return for each scan at which fraction of the time from the scan before to the next one it was taken.

    intervals  seconds to each scan from the one before
    """
    following = zip(intervals, [*intervals[1:], 0.0], strict=True)
    return [before / (before + after) if before + after > 0.0 else 0.5 for before, after in following]


def even_informations(intervals: Sequence[float], fractions: Sequence[float], informations: Floats) -> Floats:
    """Return the information (n, 3, 3) of each scan's pose, if the base moved evenly between its neighbours.

    Besides the errors of their poses, it is uncertain by the change of velocity from one interval to the other. The
    first scan and the last one have the uncertainty of a tracked scan.

    intervals, fractions  of the scans, see `fractions_of`
    informations          (n, 3, 3) of their poses
    """
    before, after = np.array(intervals), np.array([*intervals[1:], 0.0])
    change = np.minimum((0.5 * (before + after))[:, None] * ACCELERATIONS, MAX_VELOCITIES)
    variances = TRACKED_SIGMAS**2 + ((np.array(fractions) * after)[:, None] * change) ** 2
    variances[[0, -1]] = TRACKED_SIGMAS**2
    weights = np.array([((1.0 - fraction) ** 2, fraction**2) for fraction in fractions])
    return np.asarray(_even_informations(variances, weights, informations))


@compiled
def _even_informations(variances, weights, informations):  # type: ignore[no-untyped-def]
    """Return (n, 3, 3) informations, see `even_informations`.

    variances  (n, 3) by the change of velocity, and of a tracked scan
    weights    (n, 2) of the covariances of the scan before and of the next one
    """
    count, result = len(variances), np.empty_like(informations)
    for row in range(count):
        covariance = np.zeros((3, 3))
        for k in range(3):
            covariance[k, k] = variances[row, k]
        if 0 < row < count - 1:
            covariance += weights[row, 0] * inverse(informations[row - 1])
            covariance += weights[row, 1] * inverse(informations[row + 1])
        result[row] = inverse(covariance)
    return result
