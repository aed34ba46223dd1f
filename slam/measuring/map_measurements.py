"""All measurements of a map, or those of some of its walls."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np

from .measurement import Kind, Measurement, are_parallel, measure_angle, measure_distance, measure_length
from .outlines import SAME_PLACE
from .rooms import Room, measure_room
from .visible_pairs import measure_pairs
from .wall_map import WallMap


def measure_map(wall_map: WallMap, rooms: Sequence[Room]) -> list[Measurement]:
    """Measure the rooms, then the other walls between two corners, then widths and thicknesses."""
    of_rooms = [measurement for room in rooms for measurement in measure_room(wall_map, room)]
    sides = [measurement for measurement in of_rooms if measurement.kind is Kind.LENGTH]
    lengths = [length for row in range(len(wall_map.walls)) for length in wall_lengths(wall_map, row)]
    others = [length for length in lengths if not any(_same(length, side) for side in sides)]
    return [*of_rooms, *others, *measure_pairs(wall_map)]


def measure_walls(wall_map: WallMap, identities: Sequence[int]) -> list[Measurement]:
    """Measure some walls, given by their landmark ids: lengths, and the distance or angle of each two of them.

    Two walls that are parallel have a distance, and the angle by which they are not; others have an angle only. Raises
    MapError if the map has no such wall.
    """
    rows = [wall_map.row(identity) for identity in dict.fromkeys(identities)]
    result = [length for row in rows for length in wall_lengths(wall_map, row)]
    for first, second in combinations(rows, 2):
        if are_parallel(wall_map, first, second):
            result.append(measure_distance(wall_map, first, second))
        result.append(measure_angle(wall_map, first, second))
    return result


def wall_lengths(wall_map: WallMap, row: int) -> list[Measurement]:
    """Measure the length of a wall (row) from each corner where a stretch of it begins to the corner where it ends.

    Only intersections with two other walls of the map bound it: an open end has no covariance.
    """
    row_of = {int(identity): other for other, identity in enumerate(wall_map.walls.identity)}
    bounds: list[tuple[float, bool, int]] = []  # place along the wall, whether it ends there, row of the other wall
    for before, after in wall_map.corners.walls.tolist():
        for other, wall, ends in ((before, after, False), (after, before, True)):
            if row_of.get(wall) == row and other in row_of and not are_parallel(wall_map, row, row_of[other]):
                place, _ = wall_map.intersection(row, row_of[other])
                bounds.append((wall_map.along(row, place), ends, row_of[other]))
    bounds.sort()
    return [
        measure_length(wall_map, start[2], row, end[2])
        for start, end in pairwise(bounds)
        if not start[1] and end[1] and end[0] - start[0] > SAME_PLACE
    ]


def _same(first: Measurement, second: Measurement) -> bool:
    """Return True if two lengths are between the same points of the same wall."""
    return first.walls == second.walls and bool(np.abs(first.ends - second.ends).max() < SAME_PLACE)
