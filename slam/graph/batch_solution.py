"""Solution of a whole graph at once, which takes the place of the incremental solver at the end of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import gtsam
import numpy as np

from ..errors import MapError
from ..geometry.segments import Floats
from .array_graph import ArrayGraph, LinearGraph
from .factors import KEY_INDEX_BITS


class BatchSolution:
    """Estimate of a graph by one Gauss-Newton step, with its covariances at the point where it is linearised.

    arrays      the graph
    linearised  (n, 3) values of the variables at which it is linearised, in the order of `arrays.keys`
    bias        range bias without which the observations are used, metres
    """

    def __init__(self, arrays: ArrayGraph, linearised: Floats, bias: float) -> None:
        self.arrays, self.linearised, self.bias = arrays, linearised, bias

    @cached_property
    def linear(self) -> LinearGraph:
        """The linearised and factorised graph. Raises MapError if it is not determined."""
        return self.arrays.linearise(self.linearised, self.bias)

    @property
    def is_determined(self) -> bool:
        """True if the step is determined."""
        try:
            return bool(np.isfinite(self.linear.step).all())
        except MapError:
            return False

    @cached_property
    def estimate(self) -> Floats:
        """The estimate (n, 3)."""
        return self.arrays.retract(self.linearised, self.linear.step)

    @cached_property
    def values(self) -> gtsam.Values:
        """The estimate as values of GTSAM."""
        return self.arrays.to_values(self.estimate)

    @property
    def step_length(self) -> float:
        """Norm of the step from `linearised` to `estimate`, metres and radians."""
        return float(np.linalg.norm(self.linear.step))

    def again(self) -> BatchSolution:
        """Return the solution that follows by another step."""
        return BatchSolution(self.arrays, self.estimate, self.bias)

    def relinearised(self, thresholds: Mapping[str, Floats]) -> BatchSolution:
        """Return the solution if variables that have moved by more than a threshold are linearised at the estimate.

        `thresholds` (d,) are those of the components of a variable, by the character of its key.
        """
        keys = np.array(self.arrays.keys, dtype=np.uint64) >> np.uint64(KEY_INDEX_BITS)
        limits = np.full(self.linearised.shape, np.inf)
        for character, threshold in thresholds.items():
            limits[keys == ord(character), : len(threshold)] = threshold
        moved = np.asarray((np.abs(self.linear.step) > limits).any(axis=1))
        if not moved.any():
            return self
        linearised = np.where(moved[:, None], self.estimate, self.linearised)
        return BatchSolution(self.arrays, linearised, self.bias)

    def covariances(self) -> dict[int, Floats]:
        """Return the covariances by key, (3, 3) or of corners (2, 2), each in the tangent space of its variable."""
        return self.arrays.by_key(self.linear.covariances())

    def joint_covariance(self, keys: Sequence[int]) -> Floats:
        """Return the joint covariance (m, m) of variables with m components in all, in the order of `keys`.

        The time grows with their number, and with that of the variables that are eliminated after them.
        """
        rows = np.searchsorted(np.array(self.arrays.keys, dtype=np.uint64), np.array(keys, dtype=np.uint64))
        joint = self.linear.joint_covariance(rows)
        used = np.flatnonzero(np.stack([np.ones(len(rows)), np.ones(len(rows)), ~self.arrays.corners[rows]], axis=1))
        return np.asarray(joint[np.ix_(used, used)])

    def joint_covariances(self, groups: Sequence[Sequence[int]]) -> list[Floats]:
        """Return the joint covariance of each group of poses or walls, by keys, in the time of some few alone."""
        return self.arrays.with_groups(groups).joint_covariances(self.linearised, self.bias)
