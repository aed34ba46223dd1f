"""What is measured in a map, for tables and drawings."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.immutable import immutable

from .map_measurements import measure_map
from .measurement import Measurement
from .openings import Opening, find_openings
from .rooms import Room, find_rooms
from .wall_map import WallMap


@immutable
class MeasuredMap:
    """Measurements, rooms and openings of a map."""

    measurements: Sequence[Measurement] = ()
    rooms: Sequence[Room] = ()
    openings: Sequence[Opening] = ()


NOTHING_MEASURED = MeasuredMap()
"""Nothing: for drawings of walls, corners and path alone."""


def measure_all(wall_map: WallMap) -> MeasuredMap:
    """Return the rooms, openings and all measurements of a map."""
    rooms = find_rooms(wall_map)
    return MeasuredMap(measure_map(wall_map, rooms), rooms, find_openings(wall_map, rooms))
