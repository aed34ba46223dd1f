"""Measurements of walls and of pairs of walls: lengths, distances, thicknesses and angles.

The estimates of two walls have common errors: those of the poses that both were seen from, and of the range bias. They
cancel in a distance, or add up. A standard deviation is therefore that of the first-order propagation J C J' of the
joint covariance C of all walls, with J the derivative of the quantity by offset and heading of each.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from features.corner_angle import MIN_SINE

from ..geometry.segments import Floats
from .wall_map import WallMap


class Kind(StrEnum):
    """Kinds of measurements.

    LENGTH      of a wall between two corners, metres
    DISTANCE    between parallel walls, perpendicular to them, metres
    WIDTH       the same, of walls that face each other across free space
    THICKNESS   the same, of walls that face away from each other: the two sides of one wall
    ANGLE       between two walls, radians; inside a room, or from 0 to pi
    AREA        of a room, without islands, square metres
    PERIMETER   of a room: all sides on walls, metres
    """

    LENGTH = "length"
    DISTANCE = "distance"
    WIDTH = "width"
    THICKNESS = "thickness"
    ANGLE = "angle"
    AREA = "area"
    PERIMETER = "perimeter"


UNITS = {Kind.ANGLE: "rad", Kind.AREA: "m2"}
"""Units of the kinds; the others are in metres."""


@immutable
class Measurement:
    """A measured quantity.

    kind    what was measured
    walls   landmark ids
    value   in metres, radians or square metres
    sigma   standard deviation
    ends    (2, 2) points in the map between which it was measured, for a drawing; twice the same if it has one place
    room    number of the room that it belongs to; None without one
    """

    kind: Kind
    walls: tuple[int, ...]
    value: float
    sigma: float
    ends: Floats
    room: int | None = None

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return UNITS.get(self.kind, "m")


def are_parallel(wall_map: WallMap, first: int, second: int) -> bool:
    """Return True if the lines of two walls (rows) have no definite intersection."""
    frames = wall_map.walls.frame
    return bool(abs(np.sin(frames[second, 2] - frames[first, 2])) <= MIN_SINE)


def measure_length(wall_map: WallMap, before: int, row: int, after: int) -> Measurement:
    """Measure the length of a wall from its intersection with one wall to that with another one (rows)."""
    (start, of_start), (end, of_end) = wall_map.intersection(before, row), wall_map.intersection(row, after)
    return _length(wall_map, row, np.stack([start, end]), np.stack([of_start, of_end]))


def _length(wall_map: WallMap, row: int, ends: Floats, jacobian: Floats, room: int | None = None) -> Measurement:
    along = ends[1] - ends[0]
    value = float(np.hypot(*along))
    sigma = wall_map.sigma(along / value @ (jacobian[1] - jacobian[0])) if value else float("nan")
    return Measurement(Kind.LENGTH, _identities(wall_map, row), value, sigma, ends, room)


def side_length(wall_map: WallMap, row: int, ends: Floats, jacobian: Floats, room: int) -> Measurement:
    """Measure a side of a room on a wall (row), between two points (2, 2) with the Jacobian (2, 2, 2 n)."""
    return _length(wall_map, row, ends, jacobian, room)


def measure_angle(wall_map: WallMap, first: int, second: int) -> Measurement:
    """Measure the angle between two walls (rows), from 0 to pi: that between the directions of their frames."""
    frames = wall_map.walls.frame
    turn = float(se2.wrap(frames[second, 2] - frames[first, 2]))
    place = wall_map.intersection(first, second)[0] if not are_parallel(wall_map, first, second) else frames[first, :2]
    return _angle(wall_map, first, second, abs(turn), place)


def interior_angle(wall_map: WallMap, before: int, after: int, corner: Floats, room: int) -> Measurement:
    """Measure the angle inside a room at the corner (2,) from one wall to the next one, counter-clockwise (rows)."""
    frames = wall_map.walls.frame
    turn = float(se2.wrap(frames[after, 2] - frames[before, 2]))
    return _angle(wall_map, before, after, np.pi - turn, corner, room)


def _angle(
    wall_map: WallMap, first: int, second: int, value: float, place: Floats, room: int | None = None
) -> Measurement:
    sigma = wall_map.sigma(wall_map.turn(second) - wall_map.turn(first))
    return Measurement(Kind.ANGLE, _identities(wall_map, first, second), value, sigma, np.stack([place, place]), room)


def measure_distance(
    wall_map: WallMap, first: int, second: int, kind: Kind = Kind.DISTANCE, along: float | None = None
) -> Measurement:
    """Measure the distance of two parallel walls (rows), perpendicular to the bisector of their directions.

    along  metres along the first wall from its frame; by default the middle of what both have in common, or of the gap
           between them
    """
    walls = wall_map.walls
    normal = wall_map.normal(first)
    other = wall_map.normal(second)
    across = normal + (other if normal @ other > 0.0 else -other)
    across /= np.hypot(*across)
    if along is None:
        ends = [wall_map.along(first, end) for end in walls.end_points()[second]]
        along = 0.5 * (max(float(walls.low[first]), min(ends)) + min(float(walls.high[first]), max(ends)))
    start = wall_map.point(first, along)
    cosine, sine = float(other @ across), float(other @ np.array([-across[1], across[0]]))
    reach = float(other @ (walls.frame[second, :2] - start)) / cosine
    end = start + reach * across
    gradient = wall_map.shift(second, wall_map.along(second, end)) - float(other @ normal) * wall_map.shift(
        first, along
    )
    gradient -= 0.5 * reach * sine * (wall_map.turn(first) + wall_map.turn(second))  # the bisector turns with the walls
    gradient /= cosine
    identities = _identities(wall_map, first, second)
    return Measurement(kind, identities, abs(reach), wall_map.sigma(gradient), np.stack([start, end]))


def _identities(wall_map: WallMap, *rows: int) -> tuple[int, ...]:
    return tuple(int(wall_map.walls.identity[row]) for row in rows)
