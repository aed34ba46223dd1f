"""Rooms: closed outlines that the robot has been in, with area and perimeter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.immutable import immutable

from ..geometry.segments import Floats
from .measurement import Kind, Measurement, are_parallel, interior_angle, side_length
from .outlines import Stretch, crossing, find_outlines
from .wall_map import WallMap

LABEL_LEVELS = 40
"""Heights in a room at which a place for its label is looked for."""
LABEL_ASPECT = 6.0
"""Ratio of a label's width to its height."""


@immutable
class Outline:
    """A closed outline of v vertices.

    stretches  of walls, in their order; beside a step they end where it is
    walls      row of the wall that each side from a vertex to the next one lies on; -1 for a step between two walls
    vertices   (v, 2) in the map, counter-clockwise around a room, clockwise around an island
    jacobian   (v, 2, 2 n) of the vertices by offset and heading of the walls
    """

    stretches: Sequence[Stretch]
    walls: Sequence[int]
    vertices: Floats
    jacobian: Floats

    @property
    def area(self) -> float:
        """Area in square metres, negative for an island."""
        x, y = self.vertices.T
        return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))

    @property
    def area_gradient(self) -> Floats:
        """Derivative (2 n,) of the area."""
        difference = np.roll(self.vertices, -1, axis=0) - np.roll(self.vertices, 1, axis=0)
        of_vertices = 0.5 * np.column_stack([difference[:, 1], -difference[:, 0]])
        return np.asarray(np.einsum("vi,vin->n", of_vertices, self.jacobian))

    @property
    def sides(self) -> Floats:
        """Sides (v, 2), each from a vertex to the next one."""
        return np.asarray(np.roll(self.vertices, -1, axis=0) - self.vertices)

    @property
    def perimeter(self) -> float:
        """Length of all sides on walls, metres."""
        return float(np.hypot(*self.sides[np.array(self.walls) >= 0].T).sum())

    @property
    def perimeter_gradient(self) -> Floats:
        """Derivative (2 n,) of the perimeter."""
        on_wall = np.array(self.walls) >= 0
        sides = self.sides[on_wall]
        direction = sides / np.hypot(*sides.T)[:, None]
        change = (np.roll(self.jacobian, -1, axis=0) - self.jacobian)[on_wall]
        return np.asarray(np.einsum("vi,vin->n", direction, change))

    def contains(self, points: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return (k,) which points (k, 2) are inside, by the parity of the sides to their right."""
        starts, ends = self.vertices, np.roll(self.vertices, -1, axis=0)
        x, y = points[:, 0, None], points[:, 1, None]
        spans = (starts[:, 1] > y) != (ends[:, 1] > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = starts[:, 0] + (y - starts[:, 1]) / (ends[:, 1] - starts[:, 1]) * (ends[:, 0] - starts[:, 0])
        return np.asarray((spans & (x < crossing)).sum(axis=1) % 2 == 1)

    def is_simple(self) -> bool:
        """Return True if no two sides cross each other."""
        starts, ends = self.vertices, np.roll(self.vertices, -1, axis=0)
        return not crossing(starts[:, None], ends[:, None], starts[None], ends[None]).any()


@immutable
class Room:
    """A room.

    number    from 1, by decreasing area
    outline   counter-clockwise
    islands   clockwise outlines inside: pillars, or the core of a building that a corridor goes around
    area, area_sigma            square metres, without the islands
    perimeter, perimeter_sigma  metres, of the sides on walls, without steps from one wall to another one
    observed  share of the outline that was seen, 0 to 1; the rest is continued along the walls
    """

    number: int
    outline: Outline
    islands: Sequence[Outline]
    area: float
    area_sigma: float
    perimeter: float
    perimeter_sigma: float
    observed: float

    @property
    def name(self) -> str:
        """Name in drawings and tables."""
        return f"room {self.number}"

    def contains(self, points: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return (k,) which points (k, 2) are inside, and in no island."""
        inside = self.outline.contains(points)
        for island in self.islands:
            inside &= ~island.contains(points)
        return inside

    @property
    def label_place(self) -> Floats:
        """Point (2,) for a label: the centre of the area, or if that is outside, the middle of a wide part."""
        x, y = self.outline.vertices.T
        cross = x * np.roll(y, -1) - np.roll(x, -1) * y
        sums = np.stack([x + np.roll(x, -1), y + np.roll(y, -1)])
        centre = np.asarray(sums @ cross / (3.0 * cross.sum()))
        if self.contains(centre[None])[0]:
            return centre
        levels = y.min() + np.ptp(y) * (np.arange(LABEL_LEVELS) + 0.5) / LABEL_LEVELS
        middles = [(0.5 * (a + b), level, b - a) for level in levels for a, b in self._stretches_along(0, level)]

        def space(candidate: tuple[float, float, float]) -> float:
            place, level, width = candidate
            above_below = min(min(level - a, b - level) for a, b in self._stretches_along(1, place) if a <= level <= b)
            return min(0.5 * width / LABEL_ASPECT, above_below)

        return np.array(max(middles, key=space)[:2])

    def _stretches_along(self, axis: int, level: float) -> list[tuple[float, float]]:
        """Return where a line parallel to an axis (0: x, 1: y) is inside, as begins and ends in metres."""
        places: list[float] = []
        for part in (self.outline, *self.islands):
            starts, ends = part.vertices, np.roll(part.vertices, -1, axis=0)
            across = (starts[:, 1 - axis] > level) != (ends[:, 1 - axis] > level)
            first, last = starts[across], ends[across]
            share = (level - first[:, 1 - axis]) / (last[:, 1 - axis] - first[:, 1 - axis])
            places += (first[:, axis] + share * (last[:, axis] - first[:, axis])).tolist()
        places.sort()
        return list(zip(places[::2], places[1::2], strict=True))


def find_rooms(wall_map: WallMap) -> list[Room]:
    """Return the rooms of a map, largest first: closed outlines around a place where the robot was."""
    outlines = [outline for chain in find_outlines(wall_map) if (outline := build_outline(wall_map, chain)) is not None]
    around = [o for o in outlines if o.area > 0.0 and o.contains(wall_map.path).any()]
    around.sort(key=lambda outline: -outline.area)
    islands: dict[int, list[Outline]] = {}
    for island in (outline for outline in outlines if outline.area < 0.0):
        within = [k for k, outline in enumerate(around) if outline.contains(island.vertices).all()]
        if within:
            islands.setdefault(within[-1], []).append(island)  # the smallest one
    return [build_room(wall_map, k + 1, outline, islands.get(k, [])) for k, outline in enumerate(around)]


def build_room(wall_map: WallMap, number: int, outline: Outline, islands: Sequence[Outline]) -> Room:
    """Return the room with an outline and islands inside."""
    parts = [outline, *islands]
    return Room(
        number,
        outline,
        islands,
        sum(part.area for part in parts),
        wall_map.sigma(np.sum([part.area_gradient for part in parts], axis=0)),
        outline.perimeter,
        wall_map.sigma(outline.perimeter_gradient),
        _observed_length(wall_map, outline) / outline.perimeter,
    )


def build_outline(wall_map: WallMap, stretches: Sequence[Stretch]) -> Outline | None:
    """Return the outline along some stretches of walls; None if it is no simple polygon.

    A stretch that the next corner leaves no length of is left out: the part of a wall that was seen beyond the corner.
    """
    remaining = list(stretches)
    while len(remaining) >= 3:
        outline = outline_along(wall_map, tuple(remaining))
        sides = [(row, side) for row, side in zip(outline.walls, outline.sides, strict=True) if row >= 0]
        lengths = [wall_map.along(row, wall_map.walls.frame[row, :2] + side) for row, side in sides]
        if min(lengths) > 0.0:
            return outline if outline.is_simple() else None
        del remaining[lengths.index(min(lengths))]  # there is one side for each stretch
    return None


def outline_along(wall_map: WallMap, stretches: Sequence[Stretch]) -> Outline:
    """Return the outline along stretches of walls: they meet at their intersection, or parallel ones at a step.

    A step that is not marked is in the middle of the gap between two parallel walls. The places of steps along the
    walls are definitions: they stay the same if the walls move, and are in the stretches of the outline.
    """
    between_steps = _place_steps(wall_map, stretches)
    rows: list[int] = []
    vertices: list[Floats] = []
    jacobian: list[Floats] = []
    for before, stretch in zip([between_steps[-1], *between_steps[:-1]], between_steps, strict=True):
        if not stretch.stepped:
            point, of_point = wall_map.intersection(before.wall, stretch.wall)
            rows, vertices, jacobian = [*rows, stretch.wall], [*vertices, point], [*jacobian, of_point]
            continue
        for row, place in ((before.wall, before.high), (stretch.wall, stretch.low)):
            vertices.append(wall_map.point(row, place))
            jacobian.append(np.outer(wall_map.normal(row), wall_map.shift(row, place)))
        rows += [-1, stretch.wall]
    return Outline(between_steps, rows, np.array(vertices), np.array(jacobian))


def _place_steps(wall_map: WallMap, stretches: Sequence[Stretch]) -> list[Stretch]:
    """Return stretches of an outline with a marked step between each two parallel ones."""
    placed = list(stretches)
    for k, stretch in enumerate(stretches):
        before = stretches[k - 1]
        if not stretch.stepped and are_parallel(wall_map, before.wall, stretch.wall):
            end = 0.5 * (before.high + wall_map.along(before.wall, wall_map.point(stretch.wall, stretch.low)))
            start = wall_map.along(stretch.wall, wall_map.point(before.wall, end))
            placed[k - 1] = placed[k - 1]._replace(high=end)
            placed[k] = placed[k]._replace(low=start, stepped=True)
    return placed


def _observed_length(wall_map: WallMap, outline: Outline) -> float:
    """Return the metres of an outline that were seen."""
    total = 0.0
    for row, start, end in zip(outline.walls, outline.vertices, np.roll(outline.vertices, -1, axis=0), strict=True):
        if row >= 0:
            low, high = wall_map.along(row, start), wall_map.along(row, end)
            pieces = np.clip(wall_map.walls.pieces[row], low, high)
            total += float((pieces[:, 1] - pieces[:, 0]).sum())
    return total


def measure_room(wall_map: WallMap, room: Room) -> list[Measurement]:
    """Measure a room: area, perimeter, the length of each side between two corners, and the angle inside each corner.

    A side that ends at a step has no length: where the step is along the wall was not measured.
    """
    outline, centre = room.outline, np.stack([room.label_place] * 2)
    identities = tuple(dict.fromkeys(int(wall_map.walls.identity[row]) for row in outline.walls if row >= 0))
    result = [
        Measurement(Kind.AREA, identities, room.area, room.area_sigma, centre, room.number),
        Measurement(Kind.PERIMETER, identities, room.perimeter, room.perimeter_sigma, centre, room.number),
    ]
    count = len(outline.vertices)
    for k, row in enumerate(outline.walls):
        ends = [k, (k + 1) % count]
        before, after = outline.walls[k - 1], outline.walls[ends[1]]
        if min(before, row, after) >= 0:
            result.append(side_length(wall_map, row, outline.vertices[ends], outline.jacobian[ends], room.number))
        if min(before, row) >= 0:
            result.append(interior_angle(wall_map, before, row, outline.vertices[k], room.number))
    return result
