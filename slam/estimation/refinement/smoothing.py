"""The path on the finished map: every scan laid over it, and odometry between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry.segments import Floats
from ...graph.chain import smooth_chain
from ...mapping.mapper import Mapper
from ...odometry.error_model import OdometryModel
from .full_map_matcher import PoseFix
from .scan_history import ScanHistory

# Of the information that a scan's placement claims: scans beside it share the errors of the walls that it is laid over.
# On recordings a third is best by a little, a tenth and all of it are as good as each other.
CLAIMED_SHARE = 0.3


def refine_path(
    mapper: Mapper, history: ScanHistory, model: OdometryModel, poses: Floats, odometry_wrong: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Poses (n, 3) of all sightings, and the share (n,) of its wall that the map explains of each.

    `poses` (k, 3) are those of the keyframes; `astray` (n,) says which sightings are already known to be. A sighting of
    which nothing was kept stays where it is, as firmly as it was placed there.
    """
    place = PoseFix(history, mapper.landmarks, poses, mapper.roughness.variance)
    placed, odometry_wrong = history.poses(poses), odometry_wrong.copy()
    informations = history.informations.copy()
    overlap_ratio = np.full(len(history), np.nan)
    for row in np.flatnonzero(history.kept).tolist():
        laid = place.match(row, placed, place.local_map(row, placed[row]))
        overlap_ratio[row] = laid.registration.overlap_ratio
        informations[row] = 0.0
        if laid.believable:
            placed[row] = laid.registration.pose
            informations[row] = laid.registration.held_by
        odometry_wrong[row] |= laid.odometry_wrong
    motions = [history.motion(row, row + 1, model, odometry_wrong) for row in range(len(history) - 1)]
    smoothed = smooth_chain(
        placed,
        CLAIMED_SHARE * informations,
        np.array([motion for motion, _ in motions]).reshape(-1, 3),
        np.array([covariance for _, covariance in motions]).reshape(-1, 3, 3),
    )
    return smoothed, overlap_ratio
