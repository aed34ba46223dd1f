"""Residuals of a graph's factors: how well the measurements fit the estimate, to find out which of them is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..geometry.segments import Floats

if TYPE_CHECKING:
    import gtsam

# Kinds of residuals. GAUGE_PRIOR is the prior that fixes a wall's frame along the wall: a convention, no measurement.
PRIOR, ODOMETRY, WALL, CORNER = "prior", "odometry", "wall", "corner"
WALL_EQUALITY, GAUGE_PRIOR = "wall equality", "gauge prior"
SCAN_MATCH, SUBMAP_MATCH, POINT_MAP, PLAN, PIN = "scan match", "submap match", "point map", "plan", "pin"
MEASUREMENTS = ODOMETRY, SCAN_MATCH, SUBMAP_MATCH, WALL, CORNER, WALL_EQUALITY, PLAN, PIN
_ENDS = {
    ODOMETRY: "xx",
    SCAN_MATCH: "px",
    SUBMAP_MATCH: "xx",
    POINT_MAP: "xp",
    WALL: "xL",
    CORNER: "xC",
    WALL_EQUALITY: "LL",
    GAUGE_PRIOR: "xL",
}
_KINDS = {
    ("xx", False): ODOMETRY,
    ("xx", True): SUBMAP_MATCH,
    ("px", True): SCAN_MATCH,
    ("xp", False): POINT_MAP,
    ("xl", False): GAUGE_PRIOR,
    ("xl", True): WALL,
    ("xc", True): CORNER,
    ("ll", False): WALL_EQUALITY,
    ("l", False): PIN,
    ("l", True): PLAN,
}
"""Kinds by the characters of a factor's variables, and by whether it is robust."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of n factors.

    kind     one of the kinds above for each
    between  (n, 2) keyframe and keyframe, keyframe and landmark, or landmark and landmark, by kind; -1 for none. The
             points of a keyframe have its number
    squared  (n,) squared Mahalanobis distance of the measurement from the estimate, without the robust kernel
    dof      (n,) degrees of freedom: the expected value of `squared` if the noise is as modelled
    weight   (n,) weight of the factor by its robust kernel, 0 to 1
    """

    kind: tuple[str, ...]
    between: NDArray[np.int64]
    squared: Floats
    dof: NDArray[np.int64]
    weight: Floats

    def __len__(self) -> int:
        return len(self.kind)

    def is_kind(self, kind: str) -> NDArray[np.bool_]:
        """Return a mask (n,) of the factors of a kind."""
        return np.array([one == kind for one in self.kind], dtype=bool)

    def worst(self, count: int) -> NDArray[np.int64]:
        """Return the indices of the measurements with the largest `squared / dof`, the worst first."""
        misfit = np.where(self.is_kind(GAUGE_PRIOR) | self.is_kind(PRIOR), -np.inf, self.squared / self.dof)
        return np.argsort(-misfit, kind="stable")[: min(count, int(np.isfinite(misfit).sum()))]

    def name(self, index: int) -> str:
        """Return a name like `x12 - L5`: x is a keyframe, p its points, L a wall, C a corner."""
        first, second = self.between[index]
        ends = _ENDS.get(self.kind[index])
        if self.kind[index] in (PLAN, PIN):
            return f"L{first}"
        return f"x{first}" if ends is None else f"{ends[0]}{first} - {ends[1]}{second}"


def residuals_of(factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Residuals:
    """Return the residuals of all factors at `values`; removed factors, which leave empty slots, are skipped."""
    import gtsam  # only here: events hold residuals, and viewers start in half the time without GTSAM

    from .factors import CAUCHY_SCALE, MOTION_CAUCHY_SCALE, WALL_CAUCHY_SCALE

    cauchy_scales = {
        SCAN_MATCH: MOTION_CAUCHY_SCALE,
        SUBMAP_MATCH: MOTION_CAUCHY_SCALE,
        WALL: WALL_CAUCHY_SCALE,
        CORNER: CAUCHY_SCALE,
        PLAN: CAUCHY_SCALE,
    }
    kinds: list[str] = []
    between: list[tuple[int, int]] = []
    squared: list[float] = []
    scale: list[float] = []
    dof: list[int] = []
    for factor in (factors.at(number) for number in range(factors.size())):
        if not isinstance(factor, gtsam.NoiseModelFactor):
            continue
        ends = [gtsam.Symbol(key) for key in list(factor.keys())]
        noise = factor.noiseModel()
        robust = isinstance(noise, gtsam.noiseModel.Robust)
        gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
        # GTSAM's whitened error of a robust factor contains the square root of its weight, so it is whitened here.
        error = gaussian.whiten(factor.unwhitenedError(values))
        kind = _KINDS.get(("".join(chr(end.chr()) for end in ends), robust), PRIOR)
        kinds.append(kind)
        between.append((ends[0].index(), ends[1].index() if len(ends) > 1 else -1))
        squared.append(float(error @ error))
        scale.append(cauchy_scales.get(kind, np.inf) if robust else np.inf)
        dof.append(_degrees_of_freedom(kind, factor.dim()))
    pairs = np.array(between, dtype=np.int64).reshape(-1, 2)
    distance = np.array(squared)
    weight = 1.0 / (1.0 + distance / np.array(scale) ** 2)
    return Residuals(tuple(kinds), pairs, distance, np.array(dof, dtype=np.int64), weight)


def _degrees_of_freedom(kind: str, dimension: int) -> int:
    """Return the number of directions of the error that have information.

    A wall's factor measures its heading or its offset, a gauge prior the position along it, a wall equality both
    heading and offset, as do a plan and a pin of a wall; GTSAM gives all of them the dimension 3.
    """
    return {WALL: 1, WALL_EQUALITY: 2, GAUGE_PRIOR: 1, PLAN: 2, PIN: 2}.get(kind, dimension)
