"""A plan: the walls of a building as another program or a person has drawn them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.immutable import immutable

from ..geometry.segments import Floats


@immutable
class Plan:
    """n straight pieces of walls, in the frame of the plan.

    name        of the file, for messages
    segments    (n, 2, 2) both end points of each piece, metres
    one_sided   (n,) true for a piece that is seen only from the left of the way from its first point to its second one;
                the others are seen from both sides
    precision   standard deviation of the points of a line in the file, metres: how exactly the file states them
    viewpoints  (k, 2) places in free space, metres; None if the file states none
    notes       assumptions that reading the file took, for the user
    """

    name: str
    segments: Floats
    one_sided: NDArray[np.bool_]
    precision: float
    viewpoints: Floats | None = None
    notes: Sequence[str] = ()

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the plan, metres."""
        points = self.segments.reshape(-1, 2)
        width, height = (points.max(axis=0) - points.min(axis=0)).tolist()
        return width, height
