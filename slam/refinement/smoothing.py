"""The path on the finished map: every scan laid over it, and odometry between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..graph import smooth_chain
from ..mapper import Mapper
from ..odometry import OdometryNoise
from ..path import CLAIMED_SHARE
from ..segments import Floats
from .drive import Drive
from .placing import Place


def refine_path(
    mapper: Mapper, drive: Drive, noise: OdometryNoise, poses: Floats, astray: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Poses (n, 3) of all sightings, and the share (n,) of its wall that the map explains of each.

    `poses` (k, 3) are those of the keyframes; `astray` (n,) says which sightings are already known to be.
    """
    place = Place(drive, mapper.landmarks, poses, mapper.flatness.variance)
    placed, astray = drive.poses(poses), astray.copy()
    informations = np.zeros((len(drive), 3, 3))
    explained = np.zeros(len(drive))
    for row in range(len(drive)):
        laid = place.lay(row, placed, place.local_map(row, placed[row]))
        explained[row] = laid.registration.explained
        if laid.believable:
            placed[row] = laid.registration.pose
            informations[row] = CLAIMED_SHARE * (laid.registration.information + laid.registration.point_information)
        astray[row] |= laid.astray
    motions = [drive.motion(row, row + 1, noise, astray) for row in range(len(drive) - 1)]
    smoothed = smooth_chain(
        placed,
        informations,
        np.array([motion for motion, _ in motions]).reshape(-1, 3),
        np.array([covariance for _, covariance in motions]).reshape(-1, 3, 3),
    )
    return smoothed, explained
