"""Factors of the graph as plain data that can be stored, and their conversion into factors of GTSAM."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, P, X
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats

# Standard deviations at which the weight of a corner's observation is one half.
# Origin: chosen; not measured.
CAUCHY_SCALE = 4.0
# The same for each of the two factors of a wall's observation: together they are as strong as one of both.
# Origin: definition.
WALL_CAUCHY_SCALE = CAUCHY_SCALE / 2**0.5
# The same for odometry. Origin: chosen, smaller because single readings can be grossly wrong; not measured.
ODOMETRY_CAUCHY_SCALE = 2.0

CORNER_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SCALE)
WALL_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(WALL_CAUCHY_SCALE)
ODOMETRY_KERNEL = gtsam.noiseModel.mEstimator.Cauchy.Create(ODOMETRY_CAUCHY_SCALE)


class FactorKind(StrEnum):
    """Kinds of factors between a keyframe (or wall) `first` and a variable `second`, as written to session files.

    Their `measured` values, [x, y, heading] or [x, y], and covariances are:
    POSE_PRIOR     the pose of `first`, which defines the map's frame; (3, 3). No `second`
    ODOMETRY       the keyframe `second` in the frame of `first`; (3, 3). Robust
    GAUGE_PRIOR    the wall's frame in the frame of `first`; (1, 1), of its position along the wall
    WALL_HEADING   the wall's frame in the frame of `first`; (1, 1), of its heading. Robust
    WALL_OFFSET    [x, y, heading, lever]: as before; (1, 1), of its offset across plus lever times heading. Robust
    WALL           a segment in the frame of `first`; (2, 2), of its offset across and heading. Not a factor of GTSAM:
                   an observation that waits until the wall `second` is confirmed
    CORNER         the corner's position in the frame of `first`; (2, 2). Robust
    WALL_EQUALITY  the frame of the wall `second` in that of the wall `first`: they are one; (2, 2), as for WALL
    LOOP           the keyframe `second` in the frame of `first`, from a loop closure; (3, 3)
    POINT_MAP      the points of the keyframe `first` as a body in its frame: zero; (3, 3), the noise of its scan
    SCAN_MATCH     the keyframe `second` in the frame of the points of `first`, by matching its own points with them and
                   with those of other keyframes nearby; (3, 3). Robust
    """

    POSE_PRIOR = "pose_prior"
    ODOMETRY = "odometry"
    GAUGE_PRIOR = "gauge_prior"
    WALL_HEADING = "wall_heading"
    WALL_OFFSET = "wall_offset"
    WALL = "wall"
    CORNER = "corner"
    WALL_EQUALITY = "wall_equality"
    LOOP = "loop"
    POINT_MAP = "point_map"
    SCAN_MATCH = "scan_match"


# Standard deviations at which a factor's weight is one half; the other kinds have no robust kernel.
CAUCHY_SCALES = {
    FactorKind.ODOMETRY: ODOMETRY_CAUCHY_SCALE,
    FactorKind.SCAN_MATCH: ODOMETRY_CAUCHY_SCALE,
    FactorKind.WALL_HEADING: WALL_CAUCHY_SCALE,
    FactorKind.WALL_OFFSET: WALL_CAUCHY_SCALE,
    FactorKind.CORNER: CAUCHY_SCALE,
}


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """One factor; see FactorKind.

    bias_slope  change of the measurement per metre of range bias: (1,) of the heading or the offset, (2,) of a corner's
                position or of the offset and heading of kind WALL; (0,) of other kinds
    """

    kind: FactorKind
    first: int
    second: int
    measured: Floats
    covariance: Floats
    bias_slope: Floats = field(default_factory=lambda: np.zeros(0))

    def without_range_bias(self, bias: float) -> Floats:
        """Return the measurement as if all ranges were shorter by `bias` metres."""
        if not bias or not len(self.bias_slope):
            return self.measured
        return self.measured - bias * self.bias_direction()

    def bias_direction(self) -> Floats:
        """Return the change of `measured` per metre of range bias. All entries are zero if it does not depend on it."""
        match self.kind if len(self.bias_slope) else None:
            case FactorKind.WALL_HEADING:
                return np.array([0.0, 0.0, self.bias_slope[0]])
            case FactorKind.WALL_OFFSET:
                heading, slope = self.measured[2], self.bias_slope[0]
                return np.array([-math.sin(heading) * slope, math.cos(heading) * slope, 0.0, 0.0])
            case FactorKind.CORNER:
                return self.bias_slope
        return np.zeros_like(self.measured)


@dataclass(frozen=True, slots=True, eq=False)
class GraphState:
    """Everything a graph consists of: enough to continue with exactly the same results.

    factors          all factors, in the order in which they were added
    keyframes        (k, 3) linearisation points of the poses, not the estimate
    walls            (w,) landmark ids
    frames           (w, 3) linearisation points of the walls' frames
    corners          (c,) landmark ids
    positions        (c, 2) linearisation points of the corners
    point_maps       (p,) keyframes whose points are a body of their own
    point_map_poses  (p, 3) linearisation points of these bodies
    updates          number of updates of the estimate: every RELINEARIZE_SKIP-th relinearises
    qr               True if factors are eliminated by QR because Cholesky has failed on this graph
    bias             estimate of the range bias, metres, without which the observations are in the graph
    """

    factors: list[Factor]
    keyframes: Floats
    walls: NDArray[np.int64]
    frames: Floats
    corners: NDArray[np.int64]
    positions: Floats
    point_maps: NDArray[np.int64]
    point_map_poses: Floats
    updates: int
    qr: bool
    bias: float = 0.0


def to_pose2(pose: se2.Pose) -> gtsam.Pose2:
    """Convert a pose [x, y, heading] into GTSAM's."""
    return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def from_pose2(pose: gtsam.Pose2) -> se2.Pose:
    """Convert GTSAM's pose into [x, y, heading]."""
    return np.array((pose.x(), pose.y(), pose.theta()))


def to_gtsam_graph(factors: Iterable[Factor], bias: float = 0.0) -> gtsam.NonlinearFactorGraph:
    """Convert factors, without a range bias (metres), into a graph of GTSAM."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(to_gtsam(factor, bias))
    return graph


def to_gtsam(factor: Factor, bias: float = 0.0) -> gtsam.NonlinearFactor:
    """Convert a factor, without a range bias (metres), into GTSAM's."""
    first, second, covariance = factor.first, factor.second, factor.covariance
    measured = factor.without_range_bias(bias)
    match factor.kind:
        case FactorKind.CORNER:
            return _corner_factor(first, second, measured, covariance)
        case FactorKind.POSE_PRIOR:
            return gtsam.PriorFactorPose2(
                X(first), to_pose2(measured), gtsam.noiseModel.Gaussian.Covariance(covariance)
            )
        case FactorKind.ODOMETRY | FactorKind.SCAN_MATCH:
            gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
            robust = gtsam.noiseModel.Robust.Create(ODOMETRY_KERNEL, gaussian)
            start = X(first) if factor.kind is FactorKind.ODOMETRY else P(first)
            return gtsam.BetweenFactorPose2(start, X(second), to_pose2(measured), robust)
        case FactorKind.POINT_MAP:
            gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
            return gtsam.BetweenFactorPose2(X(first), P(first), to_pose2(measured), gaussian)
        case FactorKind.LOOP:
            gaussian = gtsam.noiseModel.Gaussian.Covariance(covariance)
            return gtsam.BetweenFactorPose2(X(first), X(second), to_pose2(measured), gaussian)
    partial = gtsam.noiseModel.Gaussian.SqrtInformation(root_information(factor), False)
    match factor.kind:
        case FactorKind.WALL_EQUALITY:
            return gtsam.BetweenFactorPose2(L(first), L(second), to_pose2(measured), partial)
        case FactorKind.GAUGE_PRIOR:
            return gtsam.BetweenFactorPose2(X(first), L(second), to_pose2(measured), partial)
    robust = gtsam.noiseModel.Robust.Create(WALL_KERNEL, partial)
    return gtsam.BetweenFactorPose2(X(first), L(second), to_pose2(measured), robust)


def _corner_factor(keyframe: int, corner: int, position: Floats, covariance: Floats) -> gtsam.NonlinearFactor:
    """Convert the observation of a corner into bearing and range."""
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance_in_polar(position, covariance))
    robust = gtsam.noiseModel.Robust.Create(CORNER_KERNEL, noise)
    x, y = float(position[0]), float(position[1])
    bearing = gtsam.Rot2.fromAngle(math.atan2(y, x))
    return gtsam.BearingRangeFactor2D(X(keyframe), C(corner), bearing, math.hypot(x, y), robust)


def covariance_in_polar(position: Floats, covariance: Floats) -> Floats:
    """Return the covariance (2, 2) of bearing and range of a position (2,) with a covariance (2, 2)."""
    x, y = float(position[0]), float(position[1])
    distance = math.hypot(x, y)
    to_polar = np.array([[-y / distance**2, x / distance**2], [x / distance, y / distance]])
    return np.asarray(to_polar @ covariance @ to_polar.T)


def root_information(factor: Factor) -> Floats:
    """Return R (3, 3) with the information R' R of a wall's factor on (along, across, heading)."""
    root, covariance = np.zeros((3, 3)), factor.covariance
    match factor.kind:
        case FactorKind.GAUGE_PRIOR:
            root[0, 0] = 1.0 / math.sqrt(covariance[0, 0])
        case FactorKind.WALL_HEADING:
            root[0, 2] = 1.0 / math.sqrt(covariance[0, 0])
        case FactorKind.WALL_OFFSET:
            root[0, 1] = 1.0 / math.sqrt(covariance[0, 0])
            root[0, 2] = factor.measured[3] * root[0, 1]
        case _:
            root[1:, 1:] = np.linalg.cholesky(np.linalg.inv(covariance)).T
    return root
