"""Fuse the poses of scans by their points and by their registration with the landmarks.

Where walls are straight, a registered pose is the more accurate one: a wall averages over many points. Where they are
rough or curved, fitted lines are off by centimetres, and scans from nearby repeat this error. It is not in the
covariance of registration. So it is estimated for the drive as a whole, from the differences e of both
poses: the variance m^2 by which e exceeds the covariances in the direction that registration determines best, and in
heading. With the covariances C_p of the points and C_r of registration, the fused pose is that of the points moved by

    (C_p^-1 + D^-1)^-1 D^-1 e,    D = C_r + diag(m^2, m^2, m_heading^2).

Both poses are computed from the same beams, so the sum of their information is too large. Smoothing, the only user,
takes a share of it (see `smoothing`).
"""

from __future__ import annotations

import numpy as np

from drivers import se2

from ...geometry.normal_distribution import NORMAL_MEDIAN
from ...geometry.segments import Floats
from .scan_history import WRONG_ODOMETRY_SIGMAS


def fuse_poses(
    points: Floats, point_informations: Floats, registered: Floats, registered_informations: Floats
) -> tuple[Floats, Floats]:
    """Return the fused poses (n, 3) of n scans, and their information (n, 3, 3) in the base's frame.

    points, registered  (n, 3) [x, y, heading] of the base in the map
    point_informations, registered_informations  (n, 3, 3) in the base's frame; they may be singular
    """
    unknown = np.diag(WRONG_ODOMETRY_SIGMAS**-2.0)
    by_points = np.asarray(np.linalg.inv(point_informations + unknown), dtype=np.float64)
    by_landmarks = np.asarray(np.linalg.inv(registered_informations + unknown), dtype=np.float64)
    difference = se2.between(points, registered)
    own = np.linalg.inv(by_landmarks + np.diag(_excess(difference, by_points, by_landmarks)))
    fused = point_informations + own
    step = np.linalg.solve(fused + unknown, np.einsum("nij,nj->ni", own, difference)[:, :, None])[:, :, 0]
    return se2.compose(points, step), fused


def _excess(difference: Floats, by_points: Floats, by_landmarks: Floats) -> Floats:
    """Return the variances (3,) of the registered poses beyond their covariances; zero if these explain all.

    Samples are converted as those of wall roughness: their median is not affected by single wrong matches.
    """
    if not len(difference):
        return np.zeros(3)
    best = np.linalg.eigh(by_landmarks[:, :2, :2])[1][:, :, 0]  # direction of the smallest variance
    expected = by_points + by_landmarks
    offset = np.einsum("ni,ni->n", best, difference[:, :2])
    variance = np.einsum("ni,nij,nj->n", best, expected[:, :2, :2], best)
    across = max(0.0, float(np.median(offset**2 / NORMAL_MEDIAN - variance)))
    turn = max(0.0, float(np.median(difference[:, 2] ** 2 / NORMAL_MEDIAN - expected[:, 2, 2])))
    return np.array([across, across, turn])
