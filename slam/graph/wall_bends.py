"""Errors of walls that no observation reveals, because walls are bent: they are added to covariances, not estimated.

Equations, whose symbols the code uses: docs/mathematics.md#bends-of-walls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from drivers.immutable import immutable

from ..geometry.segments import Floats


@immutable
class BendResponse:
    """Response of a wall's line to the bends of its surface.

    places   (n,) metres along the wall from its frame
    weights  W (2, n): change of the line's offset across and heading, at its frame, by a deviation of the surface at
             each place from a straight line
    """

    places: Floats
    weights: Floats

    def at(self, point: float) -> BendResponse:
        """Return the response at a point of the line, metres along it from its frame, which is the new origin."""
        return BendResponse(self.places - point, np.array([[1.0, point], [0.0, 1.0]]) @ self.weights)

    def minus(self, other: BendResponse) -> BendResponse:
        """Return the response of the difference to another line that is fitted to the same surface."""
        return BendResponse(
            np.concatenate([self.places, other.places]), np.concatenate([self.weights, -other.weights], axis=1)
        )

    def covariance(self, variance: float, length: float) -> Floats:
        """Return W C W' (2, 2) with bends of a variance and a correlation length, metres."""
        distance = np.subtract.outer(self.places, self.places)
        return np.asarray(variance * self.weights @ bend_correlation(distance, length) @ self.weights.T)


@immutable
class WallBends:
    """Bends of walls, and the covariances that they cause.

    sigma      standard deviation of a wall's surface from a straight line, metres; zero if it is not estimated
    length     metres along a wall over which bends are correlated; zero if it is not estimated
    responses  of walls to bends, by landmark id; walls without one are taken as straight
    """

    sigma: float = 0.0
    length: float = 0.0
    responses: Mapping[int, BendResponse] = field(default_factory=dict)

    def of_walls(self, walls: Sequence[int]) -> Floats:
        """Return the covariances (n, 2, 2) of the offset and the heading of some walls at their frames."""
        return np.array([self._of_wall(wall) for wall in walls]).reshape(-1, 2, 2)

    def of_all(self, walls: Sequence[int]) -> Floats:
        """Return the joint covariance (2 n, 2 n) of some walls: bends of two walls are independent."""
        joint = np.zeros((2 * len(walls), 2 * len(walls)))
        for row, covariance in enumerate(self.of_walls(walls)):
            joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] = covariance
        return joint

    def _of_wall(self, wall: int) -> Floats:
        response = self.responses.get(wall)
        return np.zeros((2, 2)) if response is None else response.covariance(self.sigma**2, self.length)


def bend_correlation(distance: Floats, length: float | Floats) -> Floats:
    """Return the correlation of bends at places some metres apart."""
    return np.asarray(np.exp(-0.5 * (distance / length) ** 2))
