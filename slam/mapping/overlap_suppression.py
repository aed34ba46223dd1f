"""Suppression of overlapping walls on the published map.

A wall with door frames, pillars and ledges is observed as one line or another, depending on the viewpoint: too far
apart, given their covariances, to be one landmark, and too close to be two walls. The estimate keeps both landmarks,
which does it no harm, but a map would show the wall twice. A wall cannot be seen through another one: of two that face
the same side, one a few centimetres behind the other, only one is visible. So on the map each stretch belongs to the
wall with the most observations.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Integers
from .landmarks import Landmarks
from .wall_cells import WALL_CELL

# Metres between lines of one wall: the depth of its frames, pillars and ledges. The bays of a facade are deeper.
# Origin: measured, on Intel, fr079 and CSAIL it leaves 5, 14 and 6 of 42, 104 and 49 pairs of close walls: bays.
MAX_DEPTH = 0.05
# Radians between lines of one wall. Origin: chosen, short lines on ledges are turned by some degrees; not measured.
MAX_OVERLAP_TURN = math.radians(10.0)
# Shortest run of cells that is suppressed, and that remains: walls that meet at an obtuse angle are close to each other
# over a short stretch. Origin: chosen, 0.3 m; not measured.
MIN_RUN_CELLS = 3


def suppress_overlapping_walls(landmarks: Landmarks) -> Landmarks:
    """Return a copy of the landmarks in which each stretch belongs to only one of several overlapping confirmed walls.

    Walls with more observations have priority. A wall of which nothing remains is merged into the one that overlaps it
    most. Walls of parts of the map that are not connected do not count as overlapping.
    """
    shown = copy.deepcopy(landmarks)
    rows = shown.walls.rows
    walls = np.flatnonzero(rows["in_graph"] & shown.active())
    ranked = walls[np.lexsort((walls, -rows["observations"][walls]))]
    group = shown.parts.groups_of(rows["last_seen"])
    for wall, others in _walls_alongside(rows[ranked], ranked).items():  # walls of higher rank are done already
        others = [other for other in others if rows["merged_into"][other] == other and group[other] == group[wall]]
        shared = {other: _shared_cells(shown, wall, other) for other in others}
        if not any(shared.values()):
            continue
        remaining = _long_runs(shown.covered[wall].difference(*shared.values()))
        shown.covered[wall] = remaining
        if remaining:
            shown.trim_extent(wall)
        else:
            rows["merged_into"][rows["merged_into"] == wall] = max(shared, key=lambda other: len(shared[other]))
    return shown


def _walls_alongside(rows: NDArray[np.void], walls: Integers) -> dict[int, list[int]]:
    """Return for each of the walls (n,) those before it in this order that run alongside it, facing the same side."""
    along, across, turn = np.moveaxis(se2.between(rows["frame"][:, None], rows["frame"][None, :]), -1, 0)
    reach = np.maximum(-rows["low"], rows["high"])
    near = (along - reach < rows["high"][:, None]) & (along + reach > rows["low"][:, None])
    near &= np.abs(across) < MAX_DEPTH + (reach + np.abs(along)) * math.sin(MAX_OVERLAP_TURN)
    found: dict[int, list[int]] = {}
    for later, earlier in np.argwhere(np.tril(near & (np.abs(turn) < MAX_OVERLAP_TURN), -1)):
        found.setdefault(int(walls[later]), []).append(int(walls[earlier]))
    return found


def _shared_cells(landmarks: Landmarks, wall: int, other: int) -> frozenset[int]:
    """Return the covered cells of a wall at which another wall is covered at most MAX_DEPTH before or behind it."""
    frames = landmarks.walls.rows["frame"]
    cells = np.fromiter(landmarks.covered[wall], dtype=np.int64, count=len(landmarks.covered[wall]))
    middles = np.column_stack([WALL_CELL * (cells + 0.5), np.zeros(len(cells))])
    in_other = se2.transform(se2.between(frames[other], frames[wall]), middles).reshape(-1, 2)
    close = np.abs(in_other[:, 1]) < MAX_DEPTH
    covered = landmarks.covered[other]
    places = np.floor(in_other[close, 0] / WALL_CELL).tolist()
    return _long_runs(cell for cell, place in zip(cells[close].tolist(), places, strict=True) if place in covered)


def _long_runs(cells: Iterable[int]) -> frozenset[int]:
    """Return the cells that belong to a run of at least MIN_RUN_CELLS consecutive ones."""
    found: list[int] = []
    run: list[int] = []
    for cell in sorted(cells):
        if run and cell > run[-1] + 1:
            found += run if len(run) >= MIN_RUN_CELLS else []
            run = []
        run.append(cell)
    return frozenset(found + run if len(run) >= MIN_RUN_CELLS else found)
