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
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Integers
from .landmarks import Landmarks
from .wall_cells import END_ERROR_CELLS, WALL_CELL

# Metres between lines of one wall: the depth of its frames, pillars and ledges. The bays of a facade are deeper.
# Origin: measured, on Intel, fr079 and CSAIL it leaves 5, 14 and 6 of 42, 104 and 49 pairs of close walls: bays.
MAX_DEPTH = 0.05
# Radians between lines of one wall. Origin: chosen, short lines on ledges are turned by some degrees; not measured.
MAX_OVERLAP_TURN = math.radians(10.0)


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
    pairs = ranked[_pairs_alongside(rows[ranked])]
    pairs = pairs[group[pairs[:, 0]] == group[pairs[:, 1]]]
    for wall, alongside in _places_alongside(shown, pairs).items():  # walls of higher rank are done already
        shared = {
            other: _long_runs(cell for cell, place in places if place in shown.covered[other])
            for other, places in alongside.items()
            if rows["merged_into"][other] == other
        }
        if not any(shared.values()):
            continue
        remaining = _long_runs(shown.covered[wall].difference(*shared.values()))
        shown.covered[wall] = remaining
        if remaining:
            shown.trim_extent(wall)
        else:
            rows["merged_into"][rows["merged_into"] == wall] = max(shared, key=lambda other: len(shared[other]))
    return shown


def _pairs_alongside(rows: NDArray[np.void]) -> Integers:
    """Return the pairs (p, 2) of rows of walls of which the second, an earlier row, runs alongside the first, facing
    the same side."""
    heading = rows["frame"][:, 2]
    pairs = np.argwhere(np.tril(np.abs(se2.wrap(heading[None, :] - heading[:, None])) < MAX_OVERLAP_TURN, -1))
    first, second = rows[pairs].T
    along, across, _ = se2.between(first["frame"], second["frame"]).T
    reach = np.maximum(-second["low"], second["high"])
    near = (along - reach < first["high"]) & (along + reach > first["low"])
    near &= np.abs(across) < MAX_DEPTH + (reach + np.abs(along)) * math.sin(MAX_OVERLAP_TURN)
    return np.asarray(pairs[near])


def _places_alongside(landmarks: Landmarks, pairs: Integers) -> dict[int, dict[int, list[tuple[int, int]]]]:
    """Return the pairs of cells alongside each other, by the first and the second wall of `pairs` (p, 2).

    The cells of the first wall are covered, and at most MAX_DEPTH before or behind the second wall.
    """
    frames = landmarks.walls.rows["frame"]
    covered = [landmarks.covered[wall] for wall in pairs[:, 0].tolist()]
    pair = np.repeat(np.arange(len(pairs)), [len(cells) for cells in covered])
    cells = np.fromiter(chain.from_iterable(covered), dtype=np.int64, count=len(pair))
    middles = np.column_stack([WALL_CELL * (cells + 0.5), np.zeros(len(cells))])
    relative = se2.between(frames[pairs[:, 1]], frames[pairs[:, 0]])
    along, across = se2.transform(relative[pair], middles).T
    close = np.abs(across) < MAX_DEPTH
    places = list(zip(cells[close].tolist(), np.floor(along[close] / WALL_CELL).astype(int).tolist(), strict=True))
    ends = np.cumsum(np.bincount(pair[close], minlength=len(pairs))).tolist()
    found: dict[int, dict[int, list[tuple[int, int]]]] = {}
    for (wall, other), begin, end in zip(pairs.tolist(), [0, *ends][:-1], ends, strict=True):
        found.setdefault(wall, {})[other] = places[begin:end]
    return found


def _long_runs(cells: Iterable[int]) -> frozenset[int]:
    """Return the cells that belong to a run of more than END_ERROR_CELLS consecutive ones.

    No shorter run is suppressed, or remains: walls that meet at an obtuse angle are close to each other over a short
    stretch.
    """
    runs: list[list[int]] = []
    for cell in sorted(cells):
        if not runs or cell > runs[-1][-1] + 1:
            runs.append([])
        runs[-1].append(cell)
    return frozenset(chain.from_iterable(run for run in runs if len(run) > END_ERROR_CELLS))
