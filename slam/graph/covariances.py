"""How well landmarks are known as seen from a keyframe, from what is known of all of them together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drivers import se2

from ..geometry.segments import Floats

# The kernel takes weight from honest observations, too: w = 1 / (1 + s / 8) for the squared error s, which is
# chi-square with 1 degree of freedom. The Hessian so weighted claims 1 / E[w] = 1.105 times the covariance of plain
# least squares; an M-estimator's own, E[w^2 s] / E[w + 2 s dw/ds]^2, is 1.034 times it. This is the latter divided by
# the former, for the marginals that are told; association compares with what the graph itself believes.
ROBUST_COVARIANCE_SCALE = 0.936


class LandmarkCovariances(NamedTuple):
    """How well a keyframe and landmarks are known.

    pose             (3, 3) of the keyframe in the map's axes
    walls            (n, 2, 2) of the offset across and the heading at the wall's frame, as seen from the keyframe
    corners          (m, 2, 2) of the position in the map's axes, as seen from the keyframe
    walls_in_map, corners_in_map   the same, in the map
    """

    pose: Floats
    walls: Floats
    corners: Floats
    walls_in_map: Floats
    corners_in_map: Floats


def landmark_covariances(joint: Floats, pose: se2.Pose, frames: Floats, positions: Floats) -> LandmarkCovariances:
    """From the joint covariance of a keyframe at `pose`, walls at `frames` (n, 3) and corners at `positions` (m, 2), in
    this order, each in the frame that GTSAM has it in."""
    own = joint[:3, :3]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    ends = np.cumsum([3, *(3 for _ in frames), *(2 for _ in positions)])
    wall_covariances = _relative(joint, ends[: len(frames)], 3, se2.adjoint(se2.between(frames, pose)))
    lever = positions - pose[:2]
    carry = np.zeros((len(positions), 2, 3))
    carry[:, 0, 0] = carry[:, 1, 1] = 1.0
    carry[:, 0, 2], carry[:, 1, 2] = -lever[:, 1], lever[:, 0]
    corner_covariances = _relative(joint, ends[len(frames) : -1], 2, carry @ rotation)
    blocks = [joint[at : at + 3, at : at + 3][1:, 1:] for at in ends[: len(frames)]]
    points = [joint[at : at + 2, at : at + 2] for at in ends[len(frames) : -1]]
    return LandmarkCovariances(
        rotation @ own @ rotation.T,
        wall_covariances[:, 1:, 1:],
        corner_covariances,
        ROBUST_COVARIANCE_SCALE * np.array(blocks).reshape(-1, 2, 2),
        ROBUST_COVARIANCE_SCALE * np.array(points).reshape(-1, 2, 2),
    )


def _relative(joint: Floats, begins: Floats, size: int, carry: Floats) -> Floats:
    """(n, size, size): covariances of landmarks at `begins` (n,) of a joint covariance, less the error of the pose at
    its beginning, which `carry` (n, size, 3) takes to each."""
    at = begins[:, None] + np.arange(size)
    own, cross = joint[:3, :3], joint[at, :3] @ carry.transpose(0, 2, 1)
    return np.asarray(
        joint[at[:, :, None], at[:, None, :]]
        + carry @ own @ carry.transpose(0, 2, 1)
        - cross
        - cross.transpose(0, 2, 1)
    )
