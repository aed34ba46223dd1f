"""Convert factors and poses into those of GTSAM."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from drivers import se2

from .factors import CAUCHY_SCALES, PRIOR_KINDS, WALL_KINDS, Factor, FactorKind, FactorsOfKind, by_kind

# GTSAM's kernels of the scales of the kinds of factors.
KERNELS = {kind: gtsam.noiseModel.mEstimator.Cauchy.Create(scale) for kind, scale in CAUCHY_SCALES.items()}


def to_pose2(pose: se2.Pose) -> gtsam.Pose2:
    """Convert a pose [x, y, heading] into GTSAM's."""
    return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def from_pose2(pose: gtsam.Pose2) -> se2.Pose:
    """Convert GTSAM's pose into [x, y, heading]."""
    return np.array((pose.x(), pose.y(), pose.theta()))


def to_gtsam_graph(factors: Sequence[Factor], bias: float) -> gtsam.NonlinearFactorGraph:
    """Convert factors, without a range bias (metres), into a graph of GTSAM."""
    converted: dict[int, gtsam.NonlinearFactor] = {}
    for group in by_kind(factors):
        converted.update(zip(group.rows.tolist(), _to_gtsam(group, bias), strict=True))
    graph = gtsam.NonlinearFactorGraph()
    for row in range(len(factors)):
        graph.add(converted[row])
    return graph


def _to_gtsam(group: FactorsOfKind, bias: float) -> list[gtsam.NonlinearFactor]:
    """Convert factors of one kind, without a range bias (metres), into GTSAM's."""
    ends, measured, kind = group.keys.tolist(), group.without_range_bias(bias), group.kind
    if kind is FactorKind.CORNER:
        angles, distances = np.arctan2(measured[:, 1], measured[:, 0]), np.hypot(measured[:, 0], measured[:, 1])
        return [
            gtsam.BearingRangeFactor2D(keyframe, corner, gtsam.Rot2.fromAngle(angle), distance, noise)
            for (keyframe, corner), angle, distance, noise in zip(
                ends, angles.tolist(), distances.tolist(), _noises(group, bias), strict=True
            )
        ]
    poses = [gtsam.Pose2(x, y, heading) for x, y, heading in measured[:, :3].tolist()]
    if kind in PRIOR_KINDS:
        priors = zip(ends, poses, _noises(group, bias), strict=True)
        return [gtsam.PriorFactorPose2(first, pose, noise) for (first, _), pose, noise in priors]
    return [
        gtsam.BetweenFactorPose2(first, second, pose, noise)
        for (first, second), pose, noise in zip(ends, poses, _noises(group, bias), strict=True)
    ]


def _noises(group: FactorsOfKind, bias: float) -> list[gtsam.noiseModel.Base]:
    """Return GTSAM's noise model of each factor of one kind."""
    gaussian, create = gtsam.noiseModel.Gaussian, gtsam.noiseModel.Robust.Create
    noises: list[gtsam.noiseModel.Base]
    if group.kind in WALL_KINDS:
        noises = [gaussian.SqrtInformation(root, False) for root in group.roots_of_information()]
    elif group.kind is FactorKind.CORNER:
        noises = [gaussian.Covariance(covariance) for covariance in group.covariances_in_polar(bias)]
    else:
        noises = [gaussian.Covariance(covariance) for covariance in group.covariances]
    kernel = KERNELS.get(group.kind)
    return noises if kernel is None else [create(kernel, noise) for noise in noises]
