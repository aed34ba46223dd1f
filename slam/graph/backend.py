"""Keyframes, walls and corners as variables, odometry and observations as factors, solved incrementally by iSAM2.

A wall is a Pose2: a frame on it with x along the wall. An observation is two BetweenFactorPose2: one measures only the
wall's direction, the other only its offset across, where it was seen. Along the wall neither says anything. GTSAM's
Pose2 uses the full exponential map, in which an offset along the wall, times the error in heading, leaks into the one
across it; so the offset is measured from the heading that is believed, not from the one observed: there the leak is of
second order, while the noise of the observed heading would hold the robot along a bare corridor, and pull it back.
A corner is a Point2 seen by bearing and range with a full covariance. All arithmetic stays in C++.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, X

from drivers import se2

from ..errors import MapError
from ..geometry.segments import Floats, Integers
from .covariances import ROBUST_COVARIANCE_SCALE, LandmarkCovariances, landmark_covariances
from .factor_residuals import CORNER, ODOMETRY, WALL, Residuals
from .factors import CAUCHY_SCALE, ODOMETRY_CAUCHY_SCALE, WALL_CAUCHY_SCALE, Factor, FactorKind, GraphState, made, pose2
from .residuals import residuals_of

# By how much a variable may move before it is linearised anew, metres along its axes and radians. What factors say of a
# place is linear in it, of a heading it is not. Along a wall its frame may stand anywhere.
RELINEARIZE_POSE = np.array([0.2, 0.2, 0.02])
RELINEARIZE_WALL = np.array([0.4, 0.2, 0.02])
RELINEARIZE_CORNER = np.array([0.2, 0.2])
RELINEARIZE_SKIP = 10  # updates; a tenth of the cost of relinearising at each update, for the same result
CAUCHY_SCALES = {ODOMETRY: ODOMETRY_CAUCHY_SCALE, WALL: WALL_CAUCHY_SCALE, CORNER: CAUCHY_SCALE}
REBUILDS = 3  # Gauss-Newton steps on everything
SETTLING_UPDATES = 5  # at most; the first moves by what was left to the threshold
# The same while a loop is closed, within one keyframe: what is left, a centimetre or so, follows while driving on.
CLOSING_UPDATES = 2
SETTLED = 1e-5  # metres and radians that all variables together move by in an update, when the estimate rests
ALONG_SIGMA = 0.1  # metres; says once where along a wall its frame lies, which no observation does
FIRST_POSE_SIGMAS = np.array([1e-4, 1e-4, 1e-5])  # metres, metres, radians: the first keyframe defines the map's frame
PAIRS_TOGETHER = 25  # of walls whose covariances are asked for at once: 50 walls take three times as long as 2
SAME_WALL_SIGMAS = np.array([5e-3, 3e-3])  # metres across, radians: how equal two frames of one wall are


def _parameters(factorization: str) -> gtsam.ISAM2Params:
    parameters = gtsam.ISAM2Params()
    thresholds = gtsam.ISAM2ThresholdMap()
    for symbol, threshold in (("x", RELINEARIZE_POSE), ("l", RELINEARIZE_WALL), ("c", RELINEARIZE_CORNER)):
        thresholds.insert((symbol, threshold))
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = RELINEARIZE_SKIP
    parameters.setFactorization(factorization)
    return parameters


def _array(pose: gtsam.Pose2) -> se2.Pose:
    return np.array([pose.x(), pose.y(), pose.theta()])


def _graph_of(factors: Sequence[Factor]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(made(factor))
    return graph


class FactorGraph:
    """The estimate of path and map. Additions are collected and take effect with `update`."""

    def __init__(self) -> None:
        # QR takes twice the time, and solves what Cholesky cannot: walls seen many metres from their frames, say
        self._factorization = "CHOLESKY"
        self._isam = gtsam.ISAM2(_parameters(self._factorization))
        self._updates = 0
        self._factors: dict[int, Factor] = {}  # by the numbers that iSAM2 has given them
        self._new: list[Factor] = []
        self._values = gtsam.Values()

    # --- additions

    def add_first_keyframe(self, pose: se2.Pose) -> None:
        """Keyframe 0, which defines the map's frame."""
        self._values.insert(X(0), pose2(pose))
        self._add(FactorKind.START, 0, 0, pose, np.diag(FIRST_POSE_SIGMAS**2))

    def add_keyframe(self, index: int, pose: se2.Pose, start: int, motion: se2.Pose, covariance: Floats) -> None:
        """A keyframe near `pose`, reached from the keyframe `start` by a `motion` with its covariance (3, 3)."""
        self._values.insert(X(index), pose2(pose))
        self._add(FactorKind.MOTION, start, index, motion, covariance)

    def add_wall(self, keyframe: int, wall: int, frame: se2.Pose, seen: se2.Pose) -> None:
        """A wall whose frame in the map is near `frame`, and which a keyframe sees at `seen`.

        That keyframe fixes the frame along the wall, weakly: nothing else does. No kernel may loosen this.
        """
        self._values.insert(L(wall), pose2(frame))
        self._add(FactorKind.GAUGE_PRIOR, keyframe, wall, seen, np.array([[ALONG_SIGMA**2]]))

    def observe_wall(self, keyframe: int, wall: int, frame: se2.Pose, covariance: Floats, believed: se2.Pose) -> None:
        """A segment of a wall as a keyframe sees it: its `frame`, and the covariance (2, 2) of the offset across it and
        of its heading, at that frame. `believed` is where, as seen from there, the wall's own frame is thought to be.

        With d the offset and h the heading of the wall against what is believed, the segment's centre l metres along
        measures d + l h, its direction h; given the latter, k = C_dh / C_hh of its error is known of the former.
        """
        seen = se2.between(believed, frame)
        k = covariance[0, 1] / covariance[1, 1]
        across = np.array([0.0, seen[1] - k * seen[2], 0.0])
        self._add(FactorKind.HEADING, keyframe, wall, frame, covariance[1:, 1:])
        measured = np.append(se2.compose(believed, across), seen[0] - k)
        self._add(FactorKind.OFFSET, keyframe, wall, measured, covariance[:1, :1] - k * covariance[:1, 1:])

    def add_corner(self, corner: int, position: Floats) -> None:
        """A corner near `position` in the map."""
        self._values.insert(C(corner), np.asarray(position, dtype=np.float64))

    def observe_corner(self, keyframe: int, corner: int, position: Floats, covariance: Floats) -> None:
        """A corner's `position` in a keyframe's frame, with its covariance (2, 2)."""
        self._add(FactorKind.CORNER, keyframe, corner, position, covariance)

    def tie_walls(self, wall: int, other: int, along: float) -> None:
        """Two walls are one: `other`'s frame lies on `wall`, `along` metres from its frame.

        No kernel: whether they are one was decided before.
        """
        self._add(FactorKind.WALL_EQUALITY, wall, other, np.array([along, 0.0, 0.0]), np.diag(SAME_WALL_SIGMAS**2))

    def tie_keyframes(self, old: int, keyframe: int, relative: se2.Pose, sigmas: Floats) -> None:
        """A keyframe's pose relative to an old one (sigmas (3,) in metres and radians). No kernel, as above."""
        self._add(FactorKind.LOOP, old, keyframe, relative, np.diag(sigmas**2))

    def _add(self, kind: FactorKind, first: int, second: int, measured: Floats, covariance: Floats) -> None:
        self._new.append(Factor(kind, int(first), int(second), measured, covariance))

    @property
    def factor_count(self) -> int:
        """Of the factors that hold."""
        return len(self._factors)

    def update(self) -> list[int]:
        """Bring everything added since the last update into the estimate; returns the numbers of the new factors.

        Raises MapError where the geometry leaves a variable undetermined.
        """
        return self._update(gtsam.ISAM2UpdateParams())

    def close_loop(self, old: int, keyframe: int, relative: se2.Pose, sigmas: Floats) -> list[int]:
        """Pull a keyframe to where it stands relative to an old one (sigmas (3,) in metres and radians).

        No kernel: after drift the residual is large at first. Returns the numbers of the factors made.
        """
        self.tie_keyframes(old, keyframe, relative, sigmas)
        made = self.update()
        self.settle(CLOSING_UPDATES)
        return made

    def __deepcopy__(self, memo: dict[int, object]) -> FactorGraph:
        """The same estimate, to go back to or to try something on. Nothing may be waiting for `update`."""
        other = FactorGraph()
        other._isam, other._factorization = gtsam.ISAM2(self._isam), self._factorization
        other._updates, other._factors = self._updates, dict(self._factors)
        return other

    def state(self) -> GraphState:
        """All that the graph consists of. Nothing may be waiting for `update`."""
        values = self._isam.getLinearizationPoint()
        keys: dict[str, list[int]] = {"x": [], "l": [], "c": []}
        for key in sorted(values.keys()):
            symbol = gtsam.Symbol(key)
            keys[chr(symbol.chr())].append(symbol.index())
        return GraphState(
            factors=[factor for _, factor in sorted(self._factors.items())],
            keyframes=np.array([_array(values.atPose2(X(k))) for k in keys["x"]]).reshape(-1, 3),
            walls=np.array(keys["l"], dtype=np.int64),
            frames=np.array([_array(values.atPose2(L(j))) for j in keys["l"]]).reshape(-1, 3),
            corners=np.array(keys["c"], dtype=np.int64),
            positions=np.array([values.atPoint2(C(j)) for j in keys["c"]]).reshape(-1, 2),
            updates=self._updates,
            qr=self._factorization == "QR",
        )

    @classmethod
    def restored(cls, state: GraphState) -> FactorGraph:
        """The graph that was in a state. The estimate follows from where its variables were linearised.

        Raises MapError where the state leaves a variable undetermined.
        """
        graph = cls()
        graph._factorization = "QR" if state.qr else "CHOLESKY"
        graph._isam = gtsam.ISAM2(_parameters(graph._factorization))
        for k, pose in enumerate(state.keyframes):
            graph._values.insert(X(k), pose2(pose))
        for wall, frame in zip(state.walls.tolist(), state.frames, strict=True):
            graph._values.insert(L(wall), pose2(frame))
        for corner, position in zip(state.corners.tolist(), state.positions, strict=True):
            graph._values.insert(C(corner), position)
        graph._new = list(state.factors)
        graph.update()
        for _ in range((state.updates - 1) % RELINEARIZE_SKIP):  # in step with those that linearise anew
            graph.update()
        return graph

    def remove_factors(self, numbers: Sequence[int]) -> None:
        """Take factors out again."""
        parameters = gtsam.ISAM2UpdateParams()
        parameters.removeFactorIndices = list(numbers)
        parameters.force_relinearize = True
        for number in numbers:
            del self._factors[number]
        self._update(parameters)

    def _update(
        self, parameters: gtsam.ISAM2UpdateParams, factors: gtsam.NonlinearFactorGraph | None = None
    ) -> list[int]:
        """Bring in what is new; `factors` are GTSAM's of it, if they have been made."""
        self._updates += 1
        factors = _graph_of(self._new) if factors is None else factors
        try:
            numbers = list(self._isam.update(factors, self._values, parameters).getNewFactorsIndices())
        except RuntimeError as error:
            self._factorize_by_qr(error)
            slots = self._isam.getFactorsUnsafe().size()
            numbers = list(range(slots - len(self._new), slots))
        self._factors.update(zip(numbers, self._new, strict=True))
        self._new, self._values = [], gtsam.Values()
        return numbers

    def _factorize_by_qr(self, failure: RuntimeError) -> None:
        """Solve everything afresh by QR, which goes on from here, after Cholesky has failed; what was to come in is in.

        Raises MapError where the failure is no matter of rounding: something is undetermined.
        """
        reason = f"the map cannot be estimated: {str(failure).strip().splitlines()[0]}"
        if self._factorization == "QR":
            raise MapError(reason) from failure
        self._factorization = "QR"
        slots, values = self._isam.getFactorsUnsafe(), self._isam.getLinearizationPoint()
        factors, renumbered = gtsam.NonlinearFactorGraph(), {}
        for number in range(slots.size()):
            if slots.at(number) is not None:  # else it was taken out
                renumbered[number] = factors.size()
                factors.add(slots.at(number))
        self._isam, self._updates = gtsam.ISAM2(_parameters(self._factorization)), 1
        try:
            self._isam.update(factors, values)
        except RuntimeError as error:
            raise MapError(reason) from error
        new = list(self._values.keys())
        if not all(np.isfinite(self._isam.marginalCovariance(key)).all() for key in new):
            raise MapError(reason) from failure
        self._factors = {renumbered[number]: factor for number, factor in self._factors.items()}

    def forget_observations(self, walls: Container[int], since: int) -> None:
        """Take out what keyframes from `since` on have observed of some walls: it was of others."""
        self.remove_factors(
            [
                number
                for number, factor in self._factors.items()
                if factor.kind in (FactorKind.HEADING, FactorKind.OFFSET)
                and factor.first >= since
                and factor.second in walls
            ]
        )

    def solve(self) -> None:
        """Find the best estimate of everything added to an empty graph, in batch, and take it over.

        Raises MapError where the geometry leaves a variable undetermined.
        """
        try:
            self._values = gtsam.LevenbergMarquardtOptimizer(_graph_of(self._new), self._values).optimize()
        except RuntimeError as error:
            raise MapError(f"the map cannot be estimated: {str(error).strip().splitlines()[0]}") from error
        self.update()

    def settle(self, at_most: int = SETTLING_UPDATES) -> None:
        """Update until the estimate rests, or some times; what has moved by more than the threshold is linearised
        anew."""
        parameters = gtsam.ISAM2UpdateParams()
        parameters.force_relinearize = True
        left = np.inf  # how far the estimate is from where its variables were linearised
        for _ in range(at_most):
            self._update(parameters)
            before, left = left, self._isam.getDelta().norm()
            if abs(left - before) < SETTLED:
                return

    def rebuild(self) -> None:
        """Solve everything afresh from the present estimate, at the end of a run.

        Incremental solving linearises only what moves by more than a threshold, and what it did not is weighted as it
        was then.
        """
        every = [factor for _, factor in sorted(self._factors.items())]
        factors = _graph_of(every)
        for _ in range(REBUILDS):
            self._values, self._new = self._isam.calculateEstimate(), every
            self._isam, self._factors, self._updates = gtsam.ISAM2(_parameters(self._factorization)), {}, 0
            self._update(gtsam.ISAM2UpdateParams(), factors)

    # --- the estimate

    def keyframe_pose(self, index: int) -> se2.Pose:
        """The base's pose in the map at a keyframe, also at one that waits for `update`."""
        if self._values.exists(X(index)):
            return _array(self._values.atPose2(X(index)))
        return _array(self._isam.calculateEstimatePose2(X(index)))

    def keyframe_poses(self, count: int) -> Floats:
        """(count, 3): the poses of the first `count` keyframes."""
        values = self._isam.calculateEstimate()
        return np.array([_array(values.atPose2(X(k))) for k in range(count)]).reshape(-1, 3)

    def some_poses(self, keyframes: Sequence[int]) -> Floats:
        """(n, 3): the poses of some keyframes."""
        return np.array([self.keyframe_pose(k) for k in keyframes]).reshape(-1, 3)

    def wall_frames(self, walls: Sequence[int]) -> Floats:
        """(n, 3): the frames of walls in the map."""
        return np.array([_array(self._isam.calculateEstimatePose2(L(j))) for j in walls]).reshape(-1, 3)

    def corner_positions(self, corners: Sequence[int]) -> Floats:
        """(n, 2): the positions of corners in the map."""
        return np.array([self._isam.calculateEstimatePoint2(C(j)) for j in corners]).reshape(-1, 2)

    def chi2(self) -> float:
        """The robust cost of the whole graph, times two."""
        return self.chi2_at(self)

    def chi2_at(self, other: FactorGraph) -> float:
        """The robust cost of this graph's factors, times two, at the estimate of another with the same variables."""
        return 2.0 * float(self._isam.getFactorsUnsafe().error(other._isam.calculateEstimate()))

    def residuals(self) -> Residuals:
        """How well each factor fits the estimate: ten microseconds a factor."""
        return residuals_of(self._isam.getFactorsUnsafe(), self._isam.calculateEstimate(), CAUCHY_SCALES)

    # --- its uncertainty

    def keyframe_covariance(self, index: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose, in its own frame."""
        return ROBUST_COVARIANCE_SCALE * self._marginal_covariance(X(index))

    def wall_covariance(self, wall: int) -> Floats:
        """(2, 2): covariance of a wall's offset across and heading in the map, at its frame."""
        return ROBUST_COVARIANCE_SCALE * self._marginal_covariance(L(wall))[1:, 1:]

    def corner_covariance(self, corner: int) -> Floats:
        """(2, 2): covariance of a corner's position in the map."""
        return ROBUST_COVARIANCE_SCALE * self._marginal_covariance(C(corner))

    def walls_covariances(self, pairs: Integers) -> Floats:
        """(n, 4, 4): joint covariances of pairs (n, 2) of walls: offset and heading in the map, each at its own frame.

        Many pairs together cost little more than one, up to a limit; they are best neighbours.
        """
        covariances = np.zeros((len(pairs), 4, 4))
        for first in range(0, len(pairs), PAIRS_TOGETHER):
            some = pairs[first : first + PAIRS_TOGETHER]
            walls, at = np.unique(some, return_inverse=True)
            joint = self._joint_covariance([L(wall) for wall in walls.tolist()])
            numbers = (3 * at.reshape(-1, 2, 1) + [1, 2]).reshape(-1, 4)  # of an offset and a heading in three
            covariances[first : first + len(some)] = joint[numbers[:, :, None], numbers[:, None, :]]
        return ROBUST_COVARIANCE_SCALE * covariances

    def _marginal_covariance(self, key: int) -> Floats:
        return self._ask(lambda isam: np.asarray(isam.marginalCovariance(key)))

    def _joint_covariance(self, keys: Sequence[int]) -> Floats:
        return self._ask(lambda isam: np.asarray(isam.jointMarginalCovariance(keys).fullMatrix()))

    def _ask(self, question: Callable[[gtsam.ISAM2], Floats]) -> Floats:
        """What Cholesky cannot answer is asked of QR; which is slower, and stays. Raises MapError where it cannot
        either."""
        while True:
            try:
                return question(self._isam)
            except RuntimeError as error:
                self._factorize_by_qr(error)

    def relative_covariance(self, old: int, keyframe: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose relative to an older one, in its own frame."""
        joint = self._joint_covariance([X(old), X(keyframe)])
        carry = se2.adjoint(se2.between(self.keyframe_pose(keyframe), self.keyframe_pose(old)))
        both = np.hstack([-carry, np.eye(3)])
        return np.asarray(ROBUST_COVARIANCE_SCALE * both @ joint @ both.T)

    def relative_covariances(self, keyframe: int, walls: Sequence[int], corners: Sequence[int]) -> LandmarkCovariances:
        """How well a keyframe is known in the map, and landmarks as seen from it, what is common to both left out.

        Cheap for the last keyframe and what it observed. Those in the map are a by-product, and meant for people: they
        are what `wall_covariance` and `corner_covariance` say.
        """
        keys = [X(keyframe), *(L(j) for j in walls), *(C(j) for j in corners)]
        joint = self._joint_covariance(keys)
        pose = self.keyframe_pose(keyframe)
        return landmark_covariances(joint, pose, self.wall_frames(walls), self.corner_positions(corners))
