"""Residuals of a graph's factors: how well the measurements fit the estimate, to find out which of them is wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

from ..geometry.segments import Floats

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


@immutable
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

    def expected_wall_variance(self) -> float:
        """Return the expected variance of residuals of walls, relative to that of their noise as modelled.

        The poses (3 degrees of freedom) and the walls (2) are fitted to them, which absorbs a part of the noise: this
        is the mean redundancy number of an adjustment, as far as nothing else determines poses and walls.
        """
        poses, walls = self.between[self.is_kind(WALL)].T
        if not len(walls):
            return 1.0
        fitted = 3 * len(np.unique(poses)) + 2 * len(np.unique(walls))
        return max(1.0, len(walls) - fitted) / len(walls)

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
