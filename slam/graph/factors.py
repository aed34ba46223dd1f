"""What the graph is made of, as plain data that can be written down, and as the factors of GTSAM that it stands for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, X
from numpy.typing import NDArray

from drivers import se2
from slam.segments import Floats

CAUCHY_SCALE = 4.0  # standard deviations at which an observation counts half
ODOMETRY_CAUCHY_SCALE = 2.0  # the same for odometry: single readings can be grossly wrong

OBSERVATION_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SCALE)
ODOMETRY_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(ODOMETRY_CAUCHY_SCALE)


class Kind(StrEnum):
    """What a factor says of a keyframe `first`, or of a wall, and of something `second`.

    measured [x, y, heading] or [x, y], and its noise, which is a covariance matrix but for WALL, are:
    START   the pose of `first`, which defines the map's frame; no `second`
    MOTION  the keyframe `second` as seen from `first`, by odometry; (3, 3). Robust
    ALONG   the wall's frame as seen from `first`; (1, 1), along the wall: says where on it the frame stands
    WALL    the same; (1, 3), one row of the square root of its information: r e is the error, in standard deviations,
            for e [along, across, heading] between what is measured and what is. Robust
    SEGMENT a segment of a wall as seen from `first`, of which WALLs are made once the wall is confirmed; (2, 2), of the
            offset across it and its heading. Never in a graph
    CORNER  the corner's position as seen from `first`; (2, 2). Robust
    SAME    the frame of the wall `second` as seen from the wall `first`: they are one; (2, 2) as for SEGMENT
    TIE     the keyframe `second` as seen from `first`, by a closed loop; (3, 3)
    """

    START = "start"
    MOTION = "motion"
    ALONG = "along"
    WALL = "wall"
    SEGMENT = "segment"
    CORNER = "corner"
    SAME = "same"
    TIE = "tie"


CAUCHY_SCALES = {Kind.MOTION: ODOMETRY_CAUCHY_SCALE, Kind.WALL: CAUCHY_SCALE, Kind.CORNER: CAUCHY_SCALE}
"""Standard deviations at which a factor counts half; the other kinds always count in full."""


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """One statement of the graph; see Kind."""

    kind: Kind
    first: int
    second: int
    measured: Floats
    noise: Floats


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
    first, second, measured, covariance = factor.first, factor.second, factor.measured, factor.noise
    if factor.kind is Kind.WALL:
        rows = gtsam.noiseModel.Gaussian.SqrtInformation(np.vstack([factor.noise, np.zeros((2, 3))]), False)
        robust = gtsam.noiseModel.Robust.Create(OBSERVATION_KERNEL, rows)
        return gtsam.BetweenFactorPose2(X(first), L(second), pose2(measured), robust)
    if factor.kind is Kind.CORNER:
        return _corner(first, second, measured, covariance)
    if factor.kind is Kind.START:
        return gtsam.PriorFactorPose2(X(first), pose2(measured), gtsam.noiseModel.Gaussian.Covariance(covariance))
    if factor.kind is Kind.MOTION:
        gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
        robust = gtsam.noiseModel.Robust.Create(ODOMETRY_KERNEL, gaussian)
        return gtsam.BetweenFactorPose2(X(first), X(second), pose2(measured), robust)
    if factor.kind is Kind.TIE:
        gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
        return gtsam.BetweenFactorPose2(X(first), X(second), pose2(measured), gaussian)
    partial = gtsam.noiseModel.Gaussian.SqrtInformation(_root_information(factor.kind, covariance), False)
    if factor.kind is Kind.SAME:
        return gtsam.BetweenFactorPose2(L(first), L(second), pose2(measured), partial)
    if factor.kind is Kind.ALONG:
        return gtsam.BetweenFactorPose2(X(first), L(second), pose2(measured), partial)
    raise ValueError(f"a {factor.kind} waits, it is in no graph")


def _corner(keyframe: int, corner: int, position: Floats, covariance: Floats) -> gtsam.NonlinearFactor:
    """A corner by its bearing and range."""
    x, y = float(position[0]), float(position[1])
    reach = float(np.hypot(x, y))
    to_polar = np.array([[-y / reach**2, x / reach**2], [x / reach, y / reach]])
    noise = gtsam.noiseModel.Gaussian.Covariance(to_polar @ covariance @ to_polar.T)
    robust = gtsam.noiseModel.Robust.Create(OBSERVATION_KERNEL, noise)
    bearing = gtsam.Rot2.fromAngle(float(np.arctan2(y, x)))
    return gtsam.BearingRangeFactor2D(X(keyframe), C(corner), bearing, reach, robust)


def _root_information(kind: Kind, covariance: Floats) -> Floats:
    """The upper square root (3, 3) of the information of (along, across, heading): along, or of the other two."""
    root = np.zeros((3, 3))
    if kind is Kind.ALONG:
        root[0, 0] = 1.0 / np.sqrt(covariance[0, 0])
    else:
        root[1:, 1:] = np.linalg.cholesky(np.linalg.inv(covariance)).T
    return root
