"""Uncertainty of the last keyframe's pose relative to old ones, with errors that the estimate does not contain."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..geometry.chi_square import chi_square_quantile
from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats, Integers
from ..geometry.significance import GATE
from ..mapping.mapper import Mapper
from .submap_search import SUBMAP_LENGTH

# Largest squared Mahalanobis distance. Origin: chi-square, 3 dof.
MAX_SQUARED_DISTANCE = chi_square_quantile(GATE, 3)
# Standard deviations of the estimate within which places are searched. Origin: definition, all places that
# MAX_SQUARED_DISTANCE admits. If only nearer ones were searched, a place that looks like the right one might be among
# them, and the right one, its rival, not.
SEARCH_DEVIATIONS = math.sqrt(MAX_SQUARED_DISTANCE)
# Metres, metres, radians: errors of the estimate that its covariance does not contain, such as slips that were not
# recognised. Origin: chosen; not measured.
UNMODELLED_SIGMAS = np.array([0.3, 0.3, 0.05])


class RelativeUncertainty:
    """Covariances of the pose of the last keyframe, or of another one, relative to old keyframes.

    last     the keyframe
    doubted  true if the errors of the estimate may be correlated along the drive, see `error_scale`
    """

    def __init__(self, mapper: Mapper, last: int, *, doubted: bool) -> None:
        self.doubted = doubted
        self._mapper, self._last = mapper, last
        self._travelled = np.asarray(mapper.travelled)
        self._covariances: dict[int, Floats] = {}

    def covariance(self, old: int) -> Floats:
        """Return the covariance (3, 3) of the last keyframe's pose relative to an old one, in its own frame.

        Where the errors that the estimate does not contain dominate, the rest is an upper bound, which costs little.
        """
        if old not in self._covariances:
            self.find_covariances([old])
        return self._covariances[old]

    def find_covariances(self, places: Sequence[int]) -> None:
        """Find the covariances relative to some old keyframes, in less time than one after the other."""
        covariances, unknown = self._mapper.covariances, list[int]()
        for old in places:
            scale = float(self.error_scale(old, self._last))
            bound = scale**2 * covariances.relative_bound(old, self._last)
            if _is_minor(bound):
                self._covariances[old] = bound + np.diag(UNMODELLED_SIGMAS**2)
            else:
                unknown.append(old)
        for old, estimated in zip(unknown, covariances.relative_to_all(unknown, self._last), strict=True):
            scale = float(self.error_scale(old, self._last))
            self._covariances[old] = scale**2 * estimated + np.diag(UNMODELLED_SIGMAS**2)

    def error_scale(self, keyframes: int | Integers, other: int) -> Floats:
        """Return (...) the factors of the standard deviations of the motions from keyframes (...) to another one.

        They are 1 unless the estimate is doubted. By the estimate, the errors of the n submaps between two keyframes
        are independent, and their variances add. If an error is the same in all of them, as that of a lidar, a wheel or
        a clock that no model contains, their standard deviations add instead: the sum is up to sqrt(n) times larger.
        """
        submaps = np.abs(self._travelled[other] - self._travelled[keyframes]) / SUBMAP_LENGTH
        return np.asarray(np.sqrt(np.maximum(1.0, submaps)) if self.doubted else np.ones_like(submaps))

    def is_certain(self, old: int) -> bool:
        """Return True if the pose relative to an old keyframe is certain except for UNMODELLED_SIGMAS."""
        return _is_minor(self.covariance(old) - np.diag(UNMODELLED_SIGMAS**2))

    def deviation(self, old: int) -> float:
        """Return the largest standard deviation (metres) of the position relative to an old keyframe."""
        return position_sigma(self.covariance(old))

    def search_radius(self, old: int) -> float:
        """Return the metres by which the position relative to an old keyframe may be wrong."""
        return SEARCH_DEVIATIONS * self.deviation(old)


def _is_minor(covariance: Floats) -> bool:
    """Return True if a covariance (3, 3) is below that of UNMODELLED_SIGMAS in every direction."""
    return bool(np.linalg.eigvalsh(covariance / np.outer(UNMODELLED_SIGMAS, UNMODELLED_SIGMAS))[-1] <= 1.0)
