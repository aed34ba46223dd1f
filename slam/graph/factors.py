"""What the graph is made of, as plain data that can be written down, and as the factors of GTSAM that it stands for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, X
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats

CAUCHY_SCALE = 4.0  # standard deviations at which the observation of a corner counts half
WALL_CAUCHY_SCALE = CAUCHY_SCALE / 2**0.5  # the same for one of the two numbers that a wall is observed by
ODOMETRY_CAUCHY_SCALE = 2.0  # the same for odometry: single readings can be grossly wrong

CORNER_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SCALE)
WALL_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(WALL_CAUCHY_SCALE)
ODOMETRY_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(ODOMETRY_CAUCHY_SCALE)


class FactorKind(StrEnum):
    """What a factor says of a keyframe `first`, or of a wall, and of something `second`.

    measured [x, y, heading] or [x, y], and its covariance, are:
    START   the pose of `first`, which defines the map's frame; no `second`
    MOTION  the keyframe `second` as seen from `first`, by odometry; (3, 3). Robust
    GAUGE_PRIOR   the wall's frame as seen from `first`; (1, 1), along the wall: says where on it the frame stands
    HEADING the same; (1, 1), of its heading. Robust
    OFFSET  the same, and a lever: [x, y, heading, lever]; (1, 1), of offset across plus lever times heading. Robust
    WALL    a segment of a wall that is not in the graph yet, and waits; (2, 2), of the offset across it and its heading
    CORNER  the corner's position as seen from `first`; (2, 2). Robust
    WALL_EQUALITY    the frame of the wall `second` as seen from the wall `first`: they are one; (2, 2) as for WALL
    LOOP     the keyframe `second` as seen from `first`, by a closed loop; (3, 3)
    """

    START = "start"
    MOTION = "motion"
    GAUGE_PRIOR = "along"
    HEADING = "heading"
    OFFSET = "offset"
    WALL = "wall"
    CORNER = "corner"
    WALL_EQUALITY = "same"
    LOOP = "tie"


CAUCHY_SCALES = {
    FactorKind.MOTION: ODOMETRY_CAUCHY_SCALE,
    FactorKind.HEADING: WALL_CAUCHY_SCALE,
    FactorKind.OFFSET: WALL_CAUCHY_SCALE,
    FactorKind.CORNER: CAUCHY_SCALE,
}
"""Standard deviations at which a factor counts half; the other kinds always count in full."""


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """One statement of the graph; see Kind."""

    kind: FactorKind
    first: int
    second: int
    measured: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GraphState:
    """All that a graph consists of: as much as is needed to go on from it as if it had never been away.

    factors    those that hold
    keyframes  (k, 3) where they were linearised last, not the estimate; likewise walls and corners, with their
               identities, and their frames (w, 3) and positions (c, 2)
    updates    how often the estimate was updated: of which every so many linearises anew
    qr         whether Cholesky has failed on this graph
    """

    factors: list[Factor]
    keyframes: Floats
    walls: NDArray[np.int64]
    frames: Floats
    corners: NDArray[np.int64]
    positions: Floats
    updates: int
    qr: bool


def pose2(pose: se2.Pose) -> gtsam.Pose2:
    """A pose as GTSAM has it."""
    return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def made(factor: Factor) -> gtsam.NonlinearFactor:
    """The factor of GTSAM that a statement stands for."""
    first, second, measured, covariance = factor.first, factor.second, factor.measured, factor.covariance
    if factor.kind is FactorKind.CORNER:
        return _corner(first, second, measured, covariance)
    if factor.kind is FactorKind.START:
        return gtsam.PriorFactorPose2(X(first), pose2(measured), gtsam.noiseModel.Gaussian.Covariance(covariance))
    if factor.kind is FactorKind.MOTION:
        gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
        robust = gtsam.noiseModel.Robust.Create(ODOMETRY_KERNEL, gaussian)
        return gtsam.BetweenFactorPose2(X(first), X(second), pose2(measured), robust)
    if factor.kind is FactorKind.LOOP:
        gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
        return gtsam.BetweenFactorPose2(X(first), X(second), pose2(measured), gaussian)
    partial = gtsam.noiseModel.Gaussian.SqrtInformation(root_information(factor), False)
    if factor.kind is FactorKind.WALL_EQUALITY:
        return gtsam.BetweenFactorPose2(L(first), L(second), pose2(measured), partial)
    if factor.kind is FactorKind.GAUGE_PRIOR:
        return gtsam.BetweenFactorPose2(X(first), L(second), pose2(measured), partial)
    robust = gtsam.noiseModel.Robust.Create(WALL_KERNEL, partial)
    return gtsam.BetweenFactorPose2(X(first), L(second), pose2(measured), robust)


def _corner(keyframe: int, corner: int, position: Floats, covariance: Floats) -> gtsam.NonlinearFactor:
    """A corner by its bearing and range."""
    x, y = float(position[0]), float(position[1])
    reach = float(np.hypot(x, y))
    to_polar = np.array([[-y / reach**2, x / reach**2], [x / reach, y / reach]])
    noise = gtsam.noiseModel.Gaussian.Covariance(to_polar @ covariance @ to_polar.T)
    robust = gtsam.noiseModel.Robust.Create(CORNER_KERNEL, noise)
    bearing = gtsam.Rot2.fromAngle(float(np.arctan2(y, x)))
    return gtsam.BearingRangeFactor2D(X(keyframe), C(corner), bearing, reach, robust)


def root_information(factor: Factor) -> Floats:
    """The square root (3, 3) of the information that a factor on a wall's frame has of (along, across, heading)."""
    root, covariance = np.zeros((3, 3)), factor.covariance
    match factor.kind:
        case FactorKind.GAUGE_PRIOR:
            root[0, 0] = 1.0 / np.sqrt(covariance[0, 0])
        case FactorKind.HEADING:
            root[0, 2] = 1.0 / np.sqrt(covariance[0, 0])
        case FactorKind.OFFSET:
            root[0] = np.array([0.0, 1.0, factor.measured[3]]) / np.sqrt(covariance[0, 0])
        case _:
            root[1:, 1:] = np.linalg.cholesky(np.linalg.inv(covariance)).T
    return root
