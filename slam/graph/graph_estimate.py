"""The estimate of a factor graph: values, covariances and residuals."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, P, X

from drivers import se2

from ..geometry.segments import Floats
from .covariances import ROBUST_COVARIANCE_SCALE, LandmarkCovariances, landmark_covariances
from .factor_residuals import residuals_of
from .factors import MATCH_KINDS, PIN_KINDS, Factor, FactorKind
from .isam2 import IncrementalSolver
from .range_bias import RangeBias
from .residuals import Residuals
from .wall_bends import WallBends


class Marginals:
    """Covariances of all variables of a graph, times ROBUST_COVARIANCE_SCALE, and of the bends of walls."""

    def __init__(self, covariances: Mapping[int, Floats], bends: WallBends) -> None:
        """Take the covariances of the graph by the keys of the variables."""
        self._covariances, self._bends = covariances, bends

    def keyframes(self, indices: Iterable[int]) -> Floats:
        """Return the covariances (n, 3, 3) of keyframes' poses, each in its own frame."""
        return self._scaled([self._covariances[X(k)] for k in indices], 3)

    def walls(self, walls: Sequence[int]) -> Floats:
        """Return the covariances (n, 2, 2) of walls' offsets across and headings in the map, each at its frame."""
        return self._scaled([self._covariances[L(j)][1:, 1:] for j in walls], 2) + self._bends.of_walls(walls)

    def corners(self, corners: Iterable[int]) -> Floats:
        """Return the covariances (n, 2, 2) of corners' positions in the map."""
        return self._scaled([self._covariances[C(j)] for j in corners], 2)

    @staticmethod
    def _scaled(covariances: Sequence[Floats], size: int) -> Floats:
        return ROBUST_COVARIANCE_SCALE * np.array(covariances).reshape(-1, size, size)


class GraphEstimate:
    """Queries of a solved factor graph.

    Poses are [x, y, heading] in metres and radians. Variables are addressed by keyframe index and landmark id.
    Covariances are those of the graph times ROBUST_COVARIANCE_SCALE, except in `relative_covariances`.

    solver      the incremental solver
    wall_bends  bends of walls, as estimated at the end of a run: they are in the covariances of walls in the map
    """

    def __init__(self) -> None:
        self.solver = IncrementalSolver()
        self.wall_bends = WallBends()

    def keyframe_pose(self, index: int) -> se2.Pose:
        """Return a keyframe's pose in the map."""
        return np.asarray(self.solver.poses([X(index)])[0])

    def keyframe_poses(self, count: int) -> Floats:
        """Return the poses (count, 3) of the first `count` keyframes."""
        values = self.solver.estimate()
        poses, keys = gtsam.utilities.extractPose2(values), values.keys()  # both in the order of the keys, X the last
        first = len(poses) - (len(keys) - bisect_left(keys, X(0)))
        return np.asarray(poses[first : first + count])

    def keyframe_poses_of(self, keyframes: Sequence[int]) -> Floats:
        """Return the poses (n, 3) of the given keyframes."""
        return self.solver.poses([X(k) for k in keyframes])

    def wall_frames(self, walls: Sequence[int]) -> Floats:
        """Return the frames (n, 3) of walls in the map."""
        return self.solver.poses([L(j) for j in walls])

    def point_map_poses(self, keyframes: Sequence[int]) -> Floats:
        """Return the poses (n, 3) of the points of some keyframes, which scans are matched with."""
        return self.solver.poses([P(k) for k in keyframes])

    def corner_positions(self, corners: Sequence[int]) -> Floats:
        """Return the positions (n, 2) of corners in the map."""
        return self.solver.points([C(j) for j in corners])

    @property
    def range_bias(self) -> RangeBias:
        """Estimate of the range bias, without which the observations are in the graph."""
        return self.solver.range_bias

    @property
    def factor_count(self) -> int:
        """Number of factors, without those waiting for `update`."""
        return len(self.solver.factors)

    def matches(self) -> list[Factor]:
        """Return point maps, matches and loop factors: all that ties keyframes besides odometry and landmarks."""
        return self._factors_of(FactorKind.POINT_MAP, *MATCH_KINDS, FactorKind.LOOP)

    def last_submap_match(self) -> int | None:
        """Return the last keyframe with a submap match, without those waiting for `update`; None if there is none."""
        latest_first = reversed(self.solver.factors.values())
        return next((factor.second for factor in latest_first if factor.kind is FactorKind.SUBMAP_MATCH), None)

    def wall_observations(self) -> list[tuple[int, int]]:
        """Return the keyframe and the wall of each observation of a wall, in the order in which they were added."""
        return [(factor.first, factor.second) for factor in self._factors_of(FactorKind.WALL_HEADING)]

    def plan_walls(self) -> dict[int, Factor]:
        """Return the factor of each wall that a plan states, by wall."""
        return {f.first: f for f in self.solver.factors.values() if f.kind is FactorKind.PLAN_WALL}

    def pins(self) -> list[Factor]:
        """Return the factors with surveyed coordinates, without those waiting for `update`."""
        return self._factors_of(*PIN_KINDS)

    def _factors_of(self, *kinds: FactorKind) -> list[Factor]:
        """Return the factors of some kinds, in the order in which they were added."""
        return [factor for factor in self.solver.sorted_factors() if factor.kind in kinds]

    def chi2(self) -> float:
        """Return twice the robust cost of the whole graph."""
        return self.chi2_at(self)

    def degrees_of_freedom(self) -> int:
        """Return the dimension of all measurements less that of all variables: the expected `chi2`, without outliers.

        A wall's gauge prior counts as a measurement: it makes up for the direction that none determines.
        """
        measured = sum(len(factor.covariance) for factor in self.solver.factors.values())
        return measured - int(self.solver.estimate().dim())

    def chi2_at(self, other: GraphEstimate) -> float:
        """Return twice the robust cost of this graph's factors at the estimate of a graph with the same variables."""
        return self.solver.cost(other.solver.estimate())

    def residuals(self) -> Residuals:
        """Return the residuals of all factors."""
        return residuals_of(self.solver.sorted_factors(), self.solver.squared_distances())

    def factors_and_values(self) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Return copies of GTSAM's graph and of the estimate: keyframes have the symbols x, walls l, corners c."""
        return gtsam.NonlinearFactorGraph(self.solver.gtsam_factors()), gtsam.Values(self.solver.estimate())

    def marginals(self) -> Marginals:
        """Return the covariances of all variables: takes as long as that of some hundred alone."""
        return Marginals(self.solver.marginal_covariances(), self.wall_bends)

    def keyframe_covariance(self, index: int) -> Floats:
        """Return the covariance (3, 3) of a keyframe's pose, in its own frame."""
        return ROBUST_COVARIANCE_SCALE * self.solver.marginal_covariance(X(index))

    def wall_covariances(self, groups: Sequence[Sequence[int]]) -> list[Floats]:
        """Return the joint covariance (2 n, 2 n) of each group of n walls: offset and heading in the map, of each at
        its own frame."""
        result = []
        for joint in self.solver.joint_covariances([[L(wall) for wall in walls] for walls in groups]):
            rows = np.flatnonzero(np.arange(len(joint)) % 3)  # offset and heading of (along, offset, heading)
            result.append(ROBUST_COVARIANCE_SCALE * joint[np.ix_(rows, rows)])
        return [graph + self.wall_bends.of_all(walls) for graph, walls in zip(result, groups, strict=True)]

    def covariance_of(self, keyframes: Sequence[int], walls: Sequence[int]) -> Floats:
        """Return the joint covariance (3 k + 3 n, 3 k + 3 n) of keyframes' poses and walls' frames, each in its own."""
        keys = [*(X(k) for k in keyframes), *(L(j) for j in walls)]
        (joint,) = self.solver.joint_covariances([keys])
        return ROBUST_COVARIANCE_SCALE * joint

    def relative_covariance(self, old: int, keyframe: int) -> Floats:
        """Return the covariance (3, 3) of a keyframe's pose relative to an older one, in its own frame."""
        (covariance,) = self.relative_covariances_to_all([old], keyframe)
        return covariance

    def relative_covariances_to_all(self, old: Sequence[int], keyframe: int) -> list[Floats]:
        """Return the covariances (3, 3) of a keyframe's pose relative to each of some older ones, in its own frame."""
        if not old:
            return []
        joint = self.solver.distant_covariance([X(keyframe), *(X(one) for one in old)])
        rows = [np.r_[3 * k : 3 * k + 3, 0:3] for k in range(1, len(old) + 1)]  # of each older one and the keyframe
        return [self._of_difference(joint[np.ix_(r, r)], one, keyframe) for r, one in zip(rows, old, strict=True)]

    def _of_difference(self, joint: Floats, old: int, keyframe: int) -> Floats:
        """Return the covariance (3, 3) of a relative pose, given the joint one (6, 6) of both poses."""
        adjoint = se2.adjoint(se2.between(self.keyframe_pose(keyframe), self.keyframe_pose(old)))
        jacobian = np.hstack([-adjoint, np.eye(3)])
        return np.asarray(ROBUST_COVARIANCE_SCALE * jacobian @ joint @ jacobian.T)

    def relative_covariances(
        self, keyframes: Sequence[int], walls: Sequence[int], corners: Sequence[int]
    ) -> LandmarkCovariances:
        """Return the covariances of keyframes in the map and of landmarks relative to the last of them.

        Cheap for the last keyframes and the landmarks they observed. The landmarks' covariances in the map are a
        by-product, scaled as those of `marginals`.
        """
        keys = [*(X(k) for k in keyframes), *(L(j) for j in walls), *(C(j) for j in corners)]
        joint = self.solver.joint_covariance(keys)
        poses = self.keyframe_poses_of(keyframes)
        return landmark_covariances(joint, poses, self.wall_frames(walls), self.corner_positions(corners))
