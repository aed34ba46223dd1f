"""Smooth a trajectory: a chain of poses, each with a measured pose and odometry to the next."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from ..errors import MapError, first_line
from ..geometry.segments import Floats
from .factors import KERNELS, FactorKind, from_pose2, to_pose2

# Per square metre and square radian; added to every pose so that unmeasured directions are determined.
# Origin: numerical.
MIN_INFORMATION = 1e-6


def smooth_chain(poses: Floats, informations: Floats, motions: Floats, covariances: Floats) -> Floats:
    """Return the most likely poses (n, 3) of a trajectory, by Levenberg-Marquardt.

    poses         (n, 3) measured
    informations  (n, 3, 3) of the measured poses, each in its pose's own frame; may be singular
    motions       (n - 1, 3) from each pose to the next, by odometry; with a robust kernel
    covariances   (n - 1, 3, 3) of the motions, in the frames at their ends

    Raises MapError if the chain is undetermined.
    """
    graph, values, kernel = gtsam.NonlinearFactorGraph(), gtsam.Values(), KERNELS[FactorKind.ODOMETRY]
    for k, (pose, information) in enumerate(zip(poses, informations, strict=True)):
        values.insert(X(k), to_pose2(pose))
        noise = gtsam.noiseModel.Gaussian.Information(information + MIN_INFORMATION * np.eye(3))
        graph.add(gtsam.PriorFactorPose2(X(k), to_pose2(pose), noise))
    for k, (motion, covariance) in enumerate(zip(motions, covariances, strict=True)):
        robust = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Gaussian.Covariance(covariance))
        graph.add(gtsam.BetweenFactorPose2(X(k), X(k + 1), to_pose2(motion), robust))
    try:
        solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    except RuntimeError as error:
        raise MapError(f"the trajectory cannot be estimated: {first_line(error)}") from error
    return np.array([from_pose2(solved.atPose2(X(k))) for k in range(len(poses))]).reshape(-1, 3)
