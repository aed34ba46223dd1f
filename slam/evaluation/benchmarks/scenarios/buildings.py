"""Buildings for benchmarks that no file describes: drawn from a seed, or simple and large."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from drivers.simulation import World, WorldFile, build_world

THICKNESS = 0.12
"""Metres, of all walls."""
DOOR = 0.95
"""Metres, width of all doors."""
VISITED = 0.35
"""Share of the rooms that the robot visits."""
INSIDE = 1.0
"""Metres that the robot drives into a room."""
CLEARANCE = 0.8
"""Metres between the path and the middle of a piece of furniture, beyond half its diagonal, at least."""


def random_building(seed: int, furniture: np.random.Generator | None = None) -> World:
    """Return a building drawn from a seed: a ring of long corridors around a core, and rooms on its long sides.

    The sizes of corridors and rooms, doors, furniture and the visited rooms are random. The robot drives once around
    the ring and then half around it again.

    furniture  draws other furniture in the same rooms
    """
    random = np.random.default_rng(seed)
    width, height = random.uniform(18.0, 36.0), random.uniform(10.0, 20.0)
    corridor = random.uniform(1.6, 2.6)
    south, south_visits = _rooms(random, furniture, width, random.uniform(3.0, 6.0), 0.0, -1.0)
    north, north_visits = _rooms(random, furniture, width, random.uniform(3.0, 6.0), height, 1.0)
    core = _rectangle(corridor, corridor, width - corridor, height - corridor)
    sides = [_wall((x, 0.0), (x, height)) for x in (0.0, width)]
    low, high, left, right = corridor / 2, height - corridor / 2, corridor / 2, width - corridor / 2
    path = [(left, low)]
    for x in south_visits:
        path += [(x, low), (x, -INSIDE), (x, low)]
    path += [(right, low), (right, high)]
    for x in reversed(north_visits):
        path += [(x, high), (x, height + INSIDE), (x, high)]
    path += [(left, high), (left, low), (right, low), (right, high)]
    content = {
        "title": f"building drawn from the seed {seed}",
        "speed": 0.8,
        "path": path,
        "walls": [*core, *sides, *south["walls"], *north["walls"]],
        "boxes": [*south["boxes"], *north["boxes"]],
    }
    return build_world(f"building-{seed}", WorldFile.model_validate(content))


def _rooms(
    random: np.random.Generator,
    furniture: np.random.Generator | None,
    width: float,
    depth: float,
    y: float,
    outwards: float,
) -> tuple[dict[str, list[Any]], list[float]]:
    """Return the shapes of rooms along a corridor's side of a width, and the x of the doors of the visited rooms.

    furniture  draws the boxes instead of `random`; None if it does not
    y          of the wall between the corridor and the rooms, metres
    outwards   1 if the rooms are above it, -1 if below
    """
    back = y + outwards * depth
    walls, boxes, doors, visits = [_wall((0.0, back), (width, back))], [], [], []
    x = 0.0
    while x < width:
        end = x + random.uniform(2.8, 7.0)
        end = width if width - end < 2.8 else end
        door = random.uniform(x + 0.4, end - 0.4 - DOOR)
        doors.append([door, DOOR])
        if random.random() < VISITED:
            visits.append(door + DOOR / 2)
        walls.append(_wall((x, y), (x, back)))
        usual = _furniture(random, x, end, depth)
        pieces = usual if furniture is None else _furniture(furniture, x, end, depth)
        boxes += [_box((along, y + outwards * inside), size, turn) for along, inside, size, turn in pieces]
        x = end
    walls += [_wall((width, y), (width, back)), _wall((0.0, y), (width, y)) | {"doors": doors}]
    return {"walls": walls, "boxes": boxes}, visits


def _furniture(
    random: np.random.Generator, start: float, end: float, depth: float
) -> list[tuple[float, float, np.ndarray[Any, Any], float]]:
    """Return up to three pieces in a room from `start` to `end` along the corridor: position, size and turn.

    The position is that along the corridor and from it into the room, metres; the turn is in degrees.
    """
    pieces = []
    for _ in range(random.integers(0, 4)):
        size = random.uniform([0.4, 0.3], [1.4, 0.8])
        inside = random.uniform(INSIDE + CLEARANCE + np.hypot(*size) / 2, depth)
        along = random.uniform(start, end)
        pieces.append((along, inside, size, float(random.choice([0.0, random.uniform(0.0, 90.0)]))))
    return pieces


def room_with_boxes(seed: int, boxes: int = 16, furniture: np.random.Generator | None = None) -> World:
    """Return two rooms with a door between them and boxes in any direction, some of them close to a wall.

    furniture  draws the boxes; None for the seed's own
    """
    random = np.random.default_rng(seed) if furniture is None else furniture
    path = np.array([[1.5, 1.2], [6.5, 1.4], [6.5, 4.5], [9.5, 4.0], [13.0, 1.5], [13.0, 6.0], [9.5, 4.0], [6.0, 4.5]])
    path = np.vstack([path, [[2.0, 6.0], [1.5, 1.2]]])
    walls = _rectangle(0.0, 0.0, 15.0, 7.5)
    walls.append(_wall((8.0, 0.0), (8.0, 7.5)) | {"doors": [[3.6, 1.4]]})
    placed: list[dict[str, Any]] = []
    while len(placed) < boxes:
        at, size = random.uniform([0.3, 0.3], [14.7, 7.2]), random.uniform([0.4, 0.3], [1.2, 0.8])
        if distance_from_path(at, path) > np.hypot(*size) / 2 + CLEARANCE / 2:
            placed.append(_box((float(at[0]), float(at[1])), size, random.uniform(0.0, 90.0)))
    content = {"path": path.tolist(), "walls": walls, "boxes": placed}
    return build_world("boxes", WorldFile.model_validate(content))


def distance_from_path(point: np.ndarray[Any, Any], path: np.ndarray[Any, Any]) -> float:
    """Return the distance of a point (2,) from a polyline (n, 2), metres."""
    start, along = path[:-1], np.diff(path, axis=0)
    share = np.clip(np.sum((point - start) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
    return float(np.hypot(*(start + share[:, None] * along - point).T).min())


def wide_hall() -> World:
    """Return a hall of 30 x 22 m with some niches: in its middle, a lidar with a range of 6 m sees nothing."""
    walls = _rectangle(0.0, 0.0, 30.0, 22.0)
    for x in (4.0, 11.5, 21.0, 26.0):
        walls += [_wall((x, 0.0), (x, 1.4)), _wall((x + 1.7, 22.0), (x + 1.7, 20.8))]
    for y in (6.0, 13.0):
        walls += [_wall((0.0, y), (1.2, y)), _wall((30.0, y + 2.5), (28.6, y + 2.5))]
    path = [(3.0, 3.0), (15.0, 3.0), (15.0, 19.0), (3.0, 19.0), (3.0, 11.0), (27.0, 11.0), (27.0, 3.0), (3.0, 3.0)]
    content = {"speed": 0.8, "path": path, "walls": walls}
    return build_world("wide-hall", WorldFile.model_validate(content))


def turning_path() -> World:
    """Return a hall with pieces of wall in which the robot turns on the spot by 90 to 180 degrees every few metres."""
    walls = _rectangle(0.0, 0.0, 12.0, 9.0)
    walls += [_wall((4.0, 0.0), (4.0, 2.0)), _wall((8.5, 9.0), (8.5, 6.6)), _wall((12.0, 4.0), (10.4, 4.0))]
    boxes = [_box((2.0, 7.5), np.array([1.2, 0.6]), 20.0), _box((6.5, 0.6), np.array([1.0, 0.6]), 0.0)]
    path = [(2.0, 4.0), (6.0, 4.0), (2.5, 4.0), (5.0, 6.5), (5.0, 3.0), (9.0, 3.0), (6.0, 3.2), (9.0, 5.5), (5.0, 5.5)]
    path += [(9.5, 5.4), (9.5, 2.0), (9.3, 5.0), (2.0, 4.5), (2.0, 2.0), (2.0, 4.2)]
    content = {"path": path, "walls": walls, "boxes": boxes}
    return build_world("turns", WorldFile.model_validate(content))


def _rectangle(left: float, low: float, right: float, high: float) -> list[dict[str, Any]]:
    corners = [(left, low), (right, low), (right, high), (left, high), (left, low)]
    return [_wall(start, end) for start, end in pairwise(corners)]


def _wall(start: tuple[float, float], end: tuple[float, float]) -> dict[str, Any]:
    return {"from": start, "to": end, "thickness": THICKNESS}


def _box(at: tuple[float, float], size: np.ndarray[Any, Any], turn: float) -> dict[str, Any]:
    return {"at": at, "size": (float(size[0]), float(size[1])), "turn": turn}
