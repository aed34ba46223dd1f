"""How well measurements fit the estimate, factor by factor: what a person looks at who asks which of them is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.segments import Floats

PRIOR, ODOMETRY, WALL, CORNER, SAME_WALL = "prior", "odometry", "wall", "corner", "same wall"
ALONG = "along"
"""What says where along a wall its frame lies: a choice, not a measurement."""
_ENDS = {ODOMETRY: "xx", WALL: "xL", CORNER: "xC", SAME_WALL: "LL", ALONG: "xL"}


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """n factors.

    kind      one of PRIOR, ODOMETRY, WALL, CORNER, SAME_WALL, ALONG for each
    between   (n, 2) keyframe and keyframe, keyframe and landmark, or landmark and landmark, by kind; -1 for none
    squared   (n,) squared Mahalanobis distance of what was measured from the estimate; no kernel has softened it
    freedom   (n,) how many numbers the factor measures: the mean of `squared`, were all noise as it is modelled
    weight    (n,) what its kernel leaves of the factor, 1 for all of it
    """

    kind: tuple[str, ...]
    between: NDArray[np.int64]
    squared: Floats
    freedom: NDArray[np.int64]
    weight: Floats

    def __len__(self) -> int:
        return len(self.kind)

    def of(self, kind: str) -> NDArray[np.bool_]:
        """(n,) which are of a kind."""
        return np.array([one == kind for one in self.kind], dtype=bool)

    def worst(self, count: int) -> NDArray[np.int64]:
        """The places of the measurements that fit worst for how many numbers they are, the worst first."""
        misfit = np.where(self.of(ALONG) | self.of(PRIOR), -np.inf, self.squared / self.freedom)
        return np.argsort(-misfit, kind="stable")[: min(count, int(np.isfinite(misfit).sum()))]

    def name(self, place: int) -> str:
        """Like `x12 - L5`: x is a keyframe, L a wall, C a corner."""
        first, second = self.between[place]
        ends = _ENDS.get(self.kind[place])
        return f"x{first}" if ends is None else f"{ends[0]}{first} - {ends[1]}{second}"
