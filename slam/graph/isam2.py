"""Incremental solver: iSAM2 that switches from Cholesky to QR if the former fails, and its marginal covariances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import gtsam
import numpy as np

from ..errors import MapError, first_line
from ..geometry.segments import Floats
from .array_graph import ArrayGraph
from .batch_solution import BatchSolution
from .factors import Factor
from .gtsam_factors import to_gtsam_graph
from .gtsam_isam2 import RELINEARIZE_SKIP, THRESHOLDS, empty_isam2, rebuilt_by_qr
from .present_solution import PresentSolution
from .range_bias import RangeBias
from .recent_variables import RecentVariables

Answer = TypeVar("Answer")


class IncrementalSolver:
    """iSAM2 with the factors it holds as plain data.

    isam     GTSAM's solver. It is built when it is needed, if there is a batch solution instead
    batch    batch solution of the whole graph, which takes the place of iSAM2 at the end of a run; None while driving
    factors  by the numbers that iSAM2 has given them
    updates  number of updates: every RELINEARIZE_SKIP-th relinearises
    qr       True if factors are eliminated by QR. It takes twice the time of Cholesky, and solves some systems on
             which Cholesky fails, e.g. with walls seen many metres from their frames
    range_bias  estimate of the range bias: factors are converted without it, and its uncertainty is in the covariances
    """

    def __init__(self, *, qr: bool = False) -> None:
        self._isam: gtsam.ISAM2 | None = empty_isam2(qr=qr)
        self._dismissed: gtsam.Values | None = None  # linearisation point of an iSAM2 that was dismissed
        self.batch: BatchSolution | None = None
        self.factors: dict[int, Factor] = {}
        self._recent, self._present = RecentVariables(), PresentSolution()
        self.updates = 0
        self.qr = qr
        self.range_bias = RangeBias()

    def copy(self) -> IncrementalSolver:
        """Return an independent solver with the same estimate."""
        other = IncrementalSolver(qr=self.qr)
        other._isam = None if self._isam is None else gtsam.ISAM2(self._isam)
        other._dismissed, other.batch = self._dismissed, self.batch
        other.factors, other.updates, other.range_bias = dict(self.factors), self.updates, self.range_bias
        other._recent, other._present = self._recent.copy(), self._present.copy()
        return other

    def reset(self) -> None:
        """Remove all factors and variables."""
        self._isam, self._dismissed, self.batch = empty_isam2(qr=self.qr), None, None
        self.factors, self.updates = {}, 0
        self._recent.forget()
        self._present.forget()

    @property
    def isam(self) -> gtsam.ISAM2:
        """GTSAM's solver, built if there is none. Raises MapError if the geometry leaves a variable undetermined."""
        if self._isam is None:
            factors, values, updates = self.sorted_factors(), self.linearisation_point(), self.updates
            self.reset()
            self.restore(factors, values, updates)
        assert self._isam is not None
        return self._isam

    @isam.setter
    def isam(self, isam: gtsam.ISAM2) -> None:
        self._isam, self._dismissed, self.batch = isam, None, None

    def dismiss_isam(self) -> None:
        """Free the memory of iSAM2, which is many times that of the factors. It is built again when it is needed."""
        if self._isam is not None:
            self._dismissed, self._isam = gtsam.Values(self._isam.getLinearizationPoint()), None

    def replace_by_batch(self, factors: Sequence[Factor], solution: BatchSolution) -> None:
        """Replace iSAM2 by a batch solution of `factors`, whose numbers are then their indices.

        iSAM2 is built from it when it is needed: for additions of keyframes, not for queries.
        """
        self._isam, self._dismissed, self.batch = None, None, solution
        self.factors, self.updates = dict(enumerate(factors)), 1
        self._recent.forget()
        self._present.forget()

    def arrays(self) -> ArrayGraph:
        """Return all factors as arrays."""
        bias = self.range_bias.metres
        return self._present.arrays(self.factors, bias) if self.batch is None else self.batch.arrays.at_bias(bias)

    def gtsam_factors(self) -> gtsam.NonlinearFactorGraph:
        """Return all factors as GTSAM's, not to be changed. Removed ones may leave empty slots."""
        if self.batch is None:
            return self.isam.getFactorsUnsafe()
        return to_gtsam_graph(self.sorted_factors(), self.batch.bias)

    # --- estimate

    def estimate(self) -> gtsam.Values:
        """Return the estimate of all variables."""
        return self._query(lambda isam: isam.calculateEstimate()) if self.batch is None else self.batch.values

    def linearisation_point(self) -> gtsam.Values:
        """Return the values of all variables at which they are linearised."""
        if self.batch is not None:
            return self.batch.arrays.to_values(self.batch.linearised)
        return self.isam.getLinearizationPoint() if self._dismissed is None else self._dismissed

    def poses(self, keys: Sequence[int]) -> Floats:
        """Return the estimates (n, 3) of poses or of the frames of walls, [x, y, heading]."""
        if self.batch is not None:
            poses = [self.batch.values.atPose2(key) for key in keys]
        else:
            poses = self._query(lambda isam: [isam.calculateEstimatePose2(key) for key in keys])
        return np.array([(pose.x(), pose.y(), pose.theta()) for pose in poses]).reshape(-1, 3)

    def points(self, keys: Sequence[int]) -> Floats:
        """Return the estimates (n, 2) of corners."""
        if self.batch is not None:
            points = [self.batch.values.atPoint2(key) for key in keys]
        else:
            points = self._query(lambda isam: [isam.calculateEstimatePoint2(key) for key in keys])
        return np.array(points).reshape(-1, 2)

    def step_length(self) -> float:
        """Return the norm of the step from the linearisation point to the estimate, metres and radians."""
        return float(self.isam.getDelta().norm()) if self.batch is None else self.batch.step_length

    def cost(self, values: gtsam.Values) -> float:
        """Return twice the robust cost of all factors at the values of the same variables."""
        if self.batch is None:
            return 2.0 * float(self.isam.getFactorsUnsafe().error(values))
        return self.batch.arrays.cost(self.batch.arrays.values_of(values), self.batch.bias)

    def squared_distances(self) -> Floats:
        """Return the squared Mahalanobis distance (f,) of each factor at the estimate, in the order of
        `sorted_factors`, without robust kernels."""
        arrays = self.arrays()
        values = arrays.values_of(self.estimate()) if self.batch is None else self.batch.estimate
        return arrays.squared_distances(values, self.range_bias.metres)

    # --- solving

    def sorted_factors(self) -> list[Factor]:
        """Return the factors in the order in which they were added."""
        return [self.factors[number] for number in sorted(self.factors)]  # pairs would be collected as garbage

    def update(
        self,
        new: Sequence[Factor],
        values: gtsam.Values,
        *,
        relinearize: bool = False,
        remove: Sequence[int] = (),
    ) -> None:
        """Add factors and initial values of new variables.

        relinearize  relinearise whatever has moved by more than its threshold, also if it is not its turn
        remove       numbers of factors to be removed

        A batch solution stays one if `relinearize` is set, and its factors are numbered again.
        Raises MapError if the geometry leaves a variable undetermined.
        """
        if self.batch is not None and relinearize and self._update_batch(self.batch, new, values, remove):
            return
        isam = self.isam
        parameters = gtsam.ISAM2UpdateParams()
        parameters.force_relinearize = relinearize
        parameters.removeFactorIndices = list(remove)
        self._present.outdate()
        for number in remove:
            del self.factors[number]
            self._recent.forget()
        parameters.constrainedKeys = self._recent.groups_with(new, self.factors)
        self.updates += 1
        added = to_gtsam_graph(new, self.range_bias.metres)
        try:
            numbers = list(isam.update(added, values, parameters).getNewFactorsIndices())
        except RuntimeError as error:
            self.switch_to_qr(error, list(values.keys()))
            slots = self.isam.getFactorsUnsafe().size()
            numbers = list(range(slots - len(new), slots))
        self.factors.update(zip(numbers, new, strict=True))

    def restore(self, factors: Sequence[Factor], values: gtsam.Values, updates: int) -> None:
        """Add the factors and linearisation points of a solver after some `updates` to this empty one.

        Empty updates come first, so that later updates relinearise at the same numbers as in that solver. None of the
        updates here relinearises, as there is no step to compare with the thresholds. Raises MapError as `update` does.
        """
        for _ in range((updates - 1) % RELINEARIZE_SKIP):
            self.update([], gtsam.Values())
        self.update(factors, values)

    def _update_batch(
        self, batch: BatchSolution, new: Sequence[Factor], values: gtsam.Values, remove: Sequence[int]
    ) -> bool:
        """Solve a batch solution again with other factors; return False if that is not determined.

        As in iSAM2, the variables are linearised where they were, unless they have moved by more than a threshold.
        """
        numbers, following = sorted(self.factors), batch.relinearised(THRESHOLDS)
        removed = np.searchsorted(numbers, sorted(remove))
        factors = [self.factors[number] for number in np.delete(numbers, removed).tolist()] + list(new)
        arrays = batch.arrays.at_bias(batch.bias).with_factors(removed, new)
        if arrays is not batch.arrays:
            known = batch.arrays.to_values(following.linearised)
            known.insert(values)
            following = BatchSolution(arrays, arrays.values_of(known), batch.bias)
        if not following.is_determined:
            return False
        self.replace_by_batch(factors, following)
        return True

    # --- covariances

    def marginal_covariance(self, key: int) -> Floats:
        """Return the covariance (3, 3), or (2, 2) of a corner, in the variable's tangent space.

        Raises MapError as `update` does.
        """
        if self.batch is not None:
            return self.joint_covariance([key])
        return self._query(lambda isam: np.asarray(isam.marginalCovariance(key))) + self.range_bias.covariance([key])

    def marginal_covariances(self) -> dict[int, Floats]:
        """Return the covariances of all variables by key, in a fraction of the time that single ones take.

        Raises MapError as `update` does.
        """
        try:
            covariances = self._as_batch().covariances()
        except MapError:  # undetermined in this form; QR may still manage
            keys = self.estimate().keys()
            return {key: self.marginal_covariance(key) for key in keys}
        return {key: block + self.range_bias.covariance([key]) for key, block in covariances.items()}

    def joint_covariances(self, groups: Sequence[Sequence[int]]) -> list[Floats]:
        """Return the joint covariance of each group of poses or walls, by keys, in the time of some few alone.

        Raises MapError as `update` does.
        """
        if not groups:
            return []
        try:
            joint = self._as_batch().joint_covariances(groups)
        except MapError:  # undetermined in this form; QR may still manage
            return [self.joint_covariance(group) for group in groups]
        return [covariance + self.range_bias.covariance(group) for covariance, group in zip(joint, groups, strict=True)]

    def _as_batch(self) -> BatchSolution:
        """Return the graph, linearised where it is, as a batch solution."""
        if self.batch is not None:
            return self.batch
        return self._present.solution(self.factors, self.range_bias.metres, self.isam.getLinearizationPoint)

    def joint_covariance(self, keys: Sequence[int]) -> Floats:
        """Return the joint covariance (m, m) of variables with m components in all, in the order of `keys`.

        Raises MapError as `update` does.
        """
        if self.batch is not None:
            joint = self.batch.joint_covariance(keys)
        else:
            joint = self._query(lambda isam: np.asarray(isam.jointMarginalCovariance(keys).fullMatrix()))
        return joint + self.range_bias.covariance(keys)

    def distant_covariance(self, keys: Sequence[int]) -> Floats:
        """Return the joint covariance as `joint_covariance` does, of variables that may be anywhere in the graph.

        It takes less time for these, and more for the variables of the last keyframes.
        Raises MapError as `update` does.
        """
        try:
            joint = self._as_batch().joint_covariance(keys)
        except MapError:  # undetermined in this form; QR may still manage
            return self.joint_covariance(keys)
        return joint + self.range_bias.covariance(keys)

    def _query(self, ask: Callable[[gtsam.ISAM2], Answer]) -> Answer:
        """Return what is asked for. If Cholesky fails, switch to QR for good; raise MapError if that fails too."""
        while True:
            try:
                return ask(self.isam)
            except RuntimeError as error:
                self.switch_to_qr(error)

    def switch_to_qr(self, failure: RuntimeError, new_keys: Sequence[int] = ()) -> None:
        """Solve everything again by QR, and keep using it, after Cholesky has failed.

        iSAM2 holds the factors and variables of the failed update already; `new_keys` are the variables that it added.
        Raises MapError if QR fails as well, or leaves a new variable undetermined.
        """
        reason = f"the map cannot be estimated: {first_line(failure)}"
        if self.qr:
            raise MapError(reason) from failure
        try:
            self._isam, renumbered = rebuilt_by_qr(self.isam)
        except RuntimeError as error:
            raise MapError(reason) from error
        self.qr, self.updates = True, 1
        if not all(np.isfinite(self.isam.marginalCovariance(key)).all() for key in new_keys):
            raise MapError(reason) from failure
        self.factors = {renumbered[number]: factor for number, factor in self.factors.items()}
        self._present.forget()
