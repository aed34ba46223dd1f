"""Incremental solver: iSAM2 that switches from Cholesky to QR if the former fails, and its marginal covariances."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np

from ..errors import MapError, first_line
from ..geometry.segments import Floats
from .array_graph import ArrayGraph
from .factors import Factor, to_gtsam_graph
from .range_bias import RangeBias

# Change of a variable beyond which it is relinearised: metres along its axes and radians. Factors are linear in
# positions but not in headings, so the threshold on the heading is the small one. A wall's frame may slide along it.
# Origin: measured, a quarter less time than 0.05 m and rad on every axis, with no worse results.
RELINEARIZE_POSE = np.array([0.2, 0.2, 0.02])
# The same for a wall's frame (along, across, heading). Origin: measured, as RELINEARIZE_POSE.
RELINEARIZE_WALL = np.array([0.4, 0.2, 0.02])
# Metres; the same for a corner. Origin: measured, as RELINEARIZE_POSE.
RELINEARIZE_CORNER = np.array([0.2, 0.2])
# Updates, each with some keyframes, from one relinearisation to the next. Origin: measured, on a recording of 1900
# keyframes: with every tenth, online poses differ three times as much from those of solving at each keyframe, for 6 %
# less time.
RELINEARIZE_SKIP = 3


def _isam2(*, qr: bool) -> gtsam.ISAM2:
    """Return an empty iSAM2 with this module's parameters."""
    parameters = gtsam.ISAM2Params()
    thresholds = gtsam.ISAM2ThresholdMap()
    for symbol, threshold in (
        ("x", RELINEARIZE_POSE),
        ("p", RELINEARIZE_POSE),
        ("l", RELINEARIZE_WALL),
        ("c", RELINEARIZE_CORNER),
    ):
        thresholds.insert((symbol, threshold))
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = RELINEARIZE_SKIP
    parameters.setFactorization("QR" if qr else "CHOLESKY")
    return gtsam.ISAM2(parameters)


class IncrementalSolver:
    """iSAM2 with the factors it holds as plain data.

    isam     GTSAM's solver
    factors  by the numbers that iSAM2 has given them
    updates  number of updates: every RELINEARIZE_SKIP-th relinearises
    qr       True if factors are eliminated by QR. It takes twice the time of Cholesky, and solves some systems on
             which Cholesky fails, e.g. with walls seen many metres from their frames
    range_bias  estimate of the range bias: factors are converted without it, and its uncertainty is in the covariances
    """

    def __init__(self, *, qr: bool = False) -> None:
        self.isam = _isam2(qr=qr)
        self.factors: dict[int, Factor] = {}
        self.updates = 0
        self.qr = qr
        self.range_bias = RangeBias()

    def copy(self) -> IncrementalSolver:
        """Return an independent solver with the same estimate."""
        other = IncrementalSolver(qr=self.qr)
        other.isam, other.factors, other.updates = gtsam.ISAM2(self.isam), dict(self.factors), self.updates
        other.range_bias = self.range_bias
        return other

    def reset(self) -> None:
        """Remove all factors and variables."""
        self.isam, self.factors, self.updates = _isam2(qr=self.qr), {}, 0

    def sorted_factors(self) -> list[Factor]:
        """Return the factors in the order in which they were added."""
        return [factor for _, factor in sorted(self.factors.items())]

    def update(
        self,
        new: Sequence[Factor],
        values: gtsam.Values,
        *,
        relinearize: bool = False,
        remove: Sequence[int] = (),
    ) -> list[int]:
        """Add factors and initial values of new variables, and return the numbers of the new factors.

        relinearize  relinearise whatever has moved by more than its threshold, also if it is not its turn
        remove       numbers of factors to be removed

        Raises MapError if the geometry leaves a variable undetermined.
        """
        parameters = gtsam.ISAM2UpdateParams()
        parameters.force_relinearize = relinearize
        parameters.removeFactorIndices = list(remove)
        for number in remove:
            del self.factors[number]
        self.updates += 1
        added = to_gtsam_graph(new, self.range_bias.metres)
        try:
            numbers = list(self.isam.update(added, values, parameters).getNewFactorsIndices())
        except RuntimeError as error:
            self.switch_to_qr(error, list(values.keys()))
            slots = self.isam.getFactorsUnsafe().size()
            numbers = list(range(slots - len(new), slots))
        self.factors.update(zip(numbers, new, strict=True))
        return numbers

    def marginal_covariance(self, key: int) -> Floats:
        """Return the covariance of one variable in its own tangent space. Raises MapError as `update` does."""
        return self._query(lambda isam: np.asarray(isam.marginalCovariance(key))) + self.range_bias.covariance([key])

    def marginal_covariances(self) -> dict[int, Floats]:
        """Return the covariances of all variables by key, in a fraction of the time of asking for one after the other.

        Raises MapError as `update` does.
        """
        bias = self.range_bias
        graph = ArrayGraph(self.sorted_factors(), bias.metres)
        try:
            blocks = graph.covariances(graph.values_of(self.isam.getLinearizationPoint()), bias.metres)
        except MapError:  # undetermined in this form; QR may still manage
            return {key: self.marginal_covariance(key) for key in graph.keys}
        return {key: block + bias.covariance([key]) for key, block in graph.by_key(blocks).items()}

    def joint_covariances(self, groups: Sequence[Sequence[int]]) -> list[Floats]:
        """Return the joint covariance of each group of poses or walls, by keys, in the time of some few alone.

        Raises MapError as `update` does.
        """
        if not groups:
            return []
        bias = self.range_bias
        graph = ArrayGraph(self.sorted_factors(), bias.metres, groups)
        try:
            joint = graph.joint_covariances(graph.values_of(self.isam.getLinearizationPoint()), bias.metres)
        except MapError:  # undetermined in this form; QR may still manage
            return [self.joint_covariance(group) for group in groups]
        return [covariance + bias.covariance(group) for covariance, group in zip(joint, groups, strict=True)]

    def joint_covariance(self, keys: Sequence[int]) -> Floats:
        """Return the joint covariance of variables, in the order of `keys`. Raises MapError as `update` does."""
        joint = self._query(lambda isam: np.asarray(isam.jointMarginalCovariance(keys).fullMatrix()))
        return joint + self.range_bias.covariance(keys)

    def _query(self, marginals: Callable[[gtsam.ISAM2], Floats]) -> Floats:
        """Compute marginals. If Cholesky fails, switch to QR for good; raise MapError if that fails too."""
        while True:
            try:
                return marginals(self.isam)
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
        self.qr = True
        slots, values = self.isam.getFactorsUnsafe(), self.isam.getLinearizationPoint()
        factors, renumbered = gtsam.NonlinearFactorGraph(), {}
        for number in range(slots.size()):
            if slots.at(number) is not None:  # removed factors leave an empty slot
                renumbered[number] = factors.size()
                factors.add(slots.at(number))
        self.isam, self.updates = _isam2(qr=True), 1
        try:
            self.isam.update(factors, values)
        except RuntimeError as error:
            raise MapError(reason) from error
        if not all(np.isfinite(self.isam.marginalCovariance(key)).all() for key in new_keys):
            raise MapError(reason) from failure
        self.factors = {renumbered[number]: factor for number, factor in self.factors.items()}
