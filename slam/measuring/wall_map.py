"""Walls with their joint covariance, and how points on them move with it."""

from __future__ import annotations

import math

import numpy as np

from drivers.immutable import immutable

from ..errors import MapError
from ..formatting import counted
from ..geometry.segments import Floats, Integers
from ..geometry.wall_intersection import intersect_walls
from ..mapping.map_features import MapCorners, MapWalls


@immutable
class WallGeometry:
    """n walls of a map, whose errors are independent, and its m corners.

    walls       the walls
    corners     the corners
    """

    walls: MapWalls
    corners: MapCorners

    def row(self, identity: int) -> int:
        """Return the row of a wall. Raises MapError if the map has no such wall."""
        rows = np.flatnonzero(self.walls.identity == identity)
        if not len(rows):
            raise MapError(f"the map has no wall {identity}; map.json and the report page list its walls")
        return int(rows[0])

    def sigma(self, gradient: Floats) -> float:
        """Return the standard deviation of a quantity with this gradient (2 n,) by the walls' offsets and headings."""
        rows = np.flatnonzero(gradient.reshape(-1, 2).any(axis=1))
        part = gradient.reshape(-1, 2)[rows].ravel()
        return math.sqrt(max(float(part @ self.joint_covariance(rows) @ part), 0.0))

    def joint_covariance(self, rows: Integers) -> Floats:
        """Return the covariance (2 k, 2 k) of offset across (metres) and heading (radians) of k walls (rows)."""
        place = np.arange(len(rows))
        blocks = np.zeros((len(rows), 2, len(rows), 2))
        blocks[place, :, place, :] = self.walls.covariance[rows]
        return blocks.reshape(2 * len(rows), 2 * len(rows))

    def point(self, row: int, along: float) -> Floats:
        """Return the point (2,) of a wall some metres along it from its frame."""
        x, y, heading = self.walls.frame[row]
        return np.array([x + along * np.cos(heading), y + along * np.sin(heading)])

    def along(self, row: int, point: Floats) -> float:
        """Return the metres along a wall, from its frame, of the point nearest to `point` (2,)."""
        x, y, heading = self.walls.frame[row]
        return float(np.cos(heading) * (point[0] - x) + np.sin(heading) * (point[1] - y))

    def normal(self, row: int) -> Floats:
        """Return the unit vector (2,) across a wall, to the side that it is seen from."""
        heading = self.walls.frame[row, 2]
        return np.array([-np.sin(heading), np.cos(heading)])

    def shift(self, row: int, along: float) -> Floats:
        """Return the gradient (2 n,) of a wall's shift across itself, some metres along it."""
        gradient = np.zeros(2 * len(self.walls))
        gradient[2 * row : 2 * row + 2] = 1.0, along
        return gradient

    def turn(self, row: int) -> Floats:
        """Return the gradient (2 n,) of a wall's heading."""
        gradient = np.zeros(2 * len(self.walls))
        gradient[2 * row + 1] = 1.0
        return gradient

    def intersection(self, first: int, second: int) -> tuple[Floats, Floats]:
        """Return the intersection (2,) of the lines of two walls, and its Jacobian (2, 2 n); they are not parallel."""
        point, of_both = intersect_walls(self.walls.frame[first], self.walls.frame[second])
        jacobian = np.zeros((2, 2 * len(self.walls)))
        jacobian[:, 2 * first : 2 * first + 2] = of_both[:, :2]
        jacobian[:, 2 * second : 2 * second + 2] = of_both[:, 2:]
        return point, jacobian


@immutable
class WallMap(WallGeometry):
    """n walls of a map with their joint covariance, its m corners, and the path that was driven.

    covariance  (2 n, 2 n) of offset across (metres) and heading (radians) of each wall at its frame
    path        (k, 2) driven positions in the map, metres
    """

    covariance: Floats
    path: Floats

    def __repr__(self) -> str:
        sizes = f"{counted(len(self.walls), 'wall')}, {counted(len(self.corners), 'corner')}"
        return f"<WallMap: {sizes}, with the joint covariance of the walls>"

    def joint_covariance(self, rows: Integers) -> Floats:
        """Return the covariance (2 k, 2 k) of offset across (metres) and heading (radians) of k walls (rows)."""
        columns = np.column_stack([2 * rows, 2 * rows + 1]).ravel()
        return np.asarray(self.covariance[np.ix_(columns, columns)])
