"""The poses along a path, each held by what it was measured to be and by odometry to the next."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from ..errors import MapError
from ..geometry.segments import Floats
from .backend import _array
from .factors import ODOMETRY_KERNEL, pose2

FREE_INFORMATION = 1e-6  # per square metre and radian: keeps what nothing measures from being undetermined


def smooth_chain(poses: Floats, informations: Floats, motions: Floats, covariances: Floats) -> Floats:
    """The likeliest poses (n, 3) of a path.

    `poses` (n, 3) were measured with `informations` (n, 3, 3), each in its pose's own frame; `motions` (n - 1, 3) lead
    from one to the next with `covariances` (n - 1, 3, 3), and may be grossly wrong. Raises MapError where that is
    undetermined.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, (pose, information) in enumerate(zip(poses, informations, strict=True)):
        values.insert(X(k), pose2(pose))
        noise = gtsam.noiseModel.Gaussian.Information(information + FREE_INFORMATION * np.eye(3))
        graph.add(gtsam.PriorFactorPose2(X(k), pose2(pose), noise))
    for k, (motion, covariance) in enumerate(zip(motions, covariances, strict=True)):
        robust = gtsam.noiseModel.Robust.Create(ODOMETRY_KERNEL, gtsam.noiseModel.Gaussian.Covariance(covariance))
        graph.add(gtsam.BetweenFactorPose2(X(k), X(k + 1), pose2(motion), robust))
    try:
        solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    except RuntimeError as error:
        raise MapError(f"the path cannot be estimated: {str(error).strip().splitlines()[0]}") from error
    return np.array([_array(solved.atPose2(X(k))) for k in range(len(poses))]).reshape(-1, 3)
