"""Errors of walls that no observation reveals, because walls are bent: they are added to covariances, not estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from drivers.immutable import immutable

from ..geometry.segments import Floats


@immutable
class WallBends:
    """Bends of walls, and the covariances that they cause.

    sigma        standard deviation of a wall's surface from a straight line, metres; zero if it is not estimated
    length       metres along a wall over which bends are correlated; zero if it is not estimated
    covariances  (2, 2) of the offset across and the heading of each wall at its frame, by landmark id
    """

    sigma: float = 0.0
    length: float = 0.0
    covariances: Mapping[int, Floats] = field(default_factory=dict)

    def of_walls(self, walls: Sequence[int]) -> Floats:
        """Return the covariances (n, 2, 2) of some walls, zero for those without one."""
        return np.array([self.covariances.get(wall, np.zeros((2, 2))) for wall in walls]).reshape(-1, 2, 2)

    def of_all(self, walls: Sequence[int]) -> Floats:
        """Return the joint covariance (2 n, 2 n) of some walls: bends of two walls are independent."""
        joint = np.zeros((2 * len(walls), 2 * len(walls)))
        for row, covariance in enumerate(self.of_walls(walls)):
            joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] = covariance
        return joint
