"""Joint covariance of the walls of a map."""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats
from ..mapping.drift_covariance import DriftCovariance
from ..mapping.map_features import MapWalls
from ..mapping.mapper import Mapper


def joint_wall_covariance(mapper: Mapper, walls: MapWalls) -> Floats:
    """Return the joint covariance (2 n, 2 n) of the walls of a settled map: offset and heading of each, at its frame.

    Two walls share the correlated drift up to when the earlier one of them was first seen. The blocks on the diagonal
    are `walls.covariance`. Raises MapError if the covariance is not determined.
    """
    if not len(walls):
        return np.zeros((0, 0))
    joint = mapper.graph.wall_covariances([walls.identity.tolist()])[0].copy()
    count, first = len(walls), mapper.landmarks.walls.rows["first_seen"][walls.identity]
    normals = np.column_stack([-np.sin(walls.frame[:, 2]), np.cos(walls.frame[:, 2])])
    shared = DriftCovariance(mapper).between(np.repeat(first, count), np.tile(first, count)).reshape(count, count, 2, 2)
    joint[::2, ::2] += np.einsum("ik,ijkl,jl->ij", normals, shared, normals)
    return joint
