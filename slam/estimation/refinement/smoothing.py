"""Estimate the trajectory on the refined map: match every scan, and smooth with odometry between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry.segments import Floats
from ...graph.chain import smooth_chain
from ...localisation.path_distances import PathDistances
from ...mapping.mapper import Mapper
from ...matching.point_matcher import INDEPENDENT_SHARE
from ...odometry.error_model import OdometryModel
from .full_map_matcher import FullMapMatcher
from .pose_fusion import fuse_poses
from .scan_history import ScanHistory


def smooth_trajectory(
    mapper: Mapper,
    history: ScanHistory,
    model: OdometryModel,
    poses: Floats,
    path_distances: PathDistances,
    odometry_wrong: NDArray[np.bool_],
) -> tuple[Floats, Floats]:
    """Return the poses (n, 3) of all scans and their overlap ratios (n,).

    poses           (k, 3) of the keyframes
    path_distances  between the keyframes
    odometry_wrong  (n,) true for scans at which odometry is known to be wrong

    A scan whose features were not stored keeps its pose, with the information of its online match.
    """
    bias = mapper.graph.range_bias.metres
    matcher = FullMapMatcher(
        history, mapper.landmarks, poses, path_distances, mapper.roughness.variances, bias, model, odometry_wrong
    )
    matched, odometry_wrong = history.scan_poses(poses), odometry_wrong.copy()
    informations = history.informations.copy()
    overlap_ratio, plausible = np.full(len(history), np.nan), np.zeros(len(history), dtype=bool)
    registered, registered_informations = matched.copy(), np.zeros_like(informations)
    for row in np.flatnonzero(history.has_features).tolist():
        match = matcher.match(row, matched, matcher.local_map(row, matched[row]))
        overlap_ratio[row] = match.registration.overlap_ratio
        informations[row], plausible[row] = 0.0, match.plausible
        if match.plausible:
            matched[row], informations[row] = match.points.pose, match.points.information
            registered[row] = match.registration.pose
            registered_informations[row] = match.registration.information
        odometry_wrong[row] |= match.odometry_wrong
    matched[plausible], informations[plausible] = fuse_poses(
        matched[plausible], informations[plausible], registered[plausible], registered_informations[plausible]
    )
    smoothed = smooth_chain(matched, INDEPENDENT_SHARE * informations, *matcher.motions.known(odometry_wrong))
    return smoothed, overlap_ratio
