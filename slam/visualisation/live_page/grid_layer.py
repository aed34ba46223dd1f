"""Occupancy grid of a live run as a layer of its page, sent by tiles: only those that have changed."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Iterator
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ...events import Event, Finished, KeyframeAdded, MapUpdated
from ...geometry.segments import Floats
from ...io.exports.live_grid import LiveGrid
from ...io.exports.occupancy import FREE, OCCUPIED, UNKNOWN, Occupancy
from .live_state import LiveState

if TYPE_CHECKING:
    from ...io.sessions import StoredSession

RESOLUTION = 0.05
"""Metres: side of a cell."""
TILE = 128
"""Cells on the side of a tile, 6.4 m."""
INTERVAL = 1.0
"""Least time between two grids, seconds."""

Cells = NDArray[np.int8]


class GridLayer:
    """Sink that draws the grid of a run into the state of its page; a context manager, at whose end all is drawn.

    lidars   returns the positions (k, 2) of the lidars on the base, metres; called from the first keyframe on
    session  that the run continues, if any
    """

    handled: ClassVar[tuple[type[Event], ...]] = (KeyframeAdded, MapUpdated, Finished)

    def __init__(self, state: LiveState, lidars: Callable[[], Floats], session: StoredSession | None = None) -> None:
        self._state, self._lidars, self._session = state, lidars, session
        self._tiles: dict[tuple[int, int], Cells] = {}  # as they were sent
        self._grid = LiveGrid(RESOLUTION, INTERVAL, np.inf, self._show)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._grid.close()

    def handle(self, event: Event) -> None:
        """Process one event."""
        if self._session is not None:
            self._grid.add_session(self._session, self._lidars())
            self._session = None
        match event:
            case KeyframeAdded():
                self._grid.add(event.stamp, event.points, self._lidars(), event.pose)
            case MapUpdated():
                self._grid.move(event.keyframe_poses)
            case Finished():
                self._grid.move(event.keyframes.poses)

    def _show(self, stamp: float, occupancy: Occupancy) -> None:
        """Show the tiles that have changed, also those that the grid no longer covers."""
        present = dict(tiles(occupancy))
        gone = {place: np.full((TILE, TILE), UNKNOWN, dtype=np.int8) for place in self._tiles.keys() - present.keys()}
        changed = {
            place: cells
            for place, cells in (present | gone).items()
            if place not in self._tiles or not np.array_equal(self._tiles[place], cells)
        }
        self._tiles |= changed
        self._state.put_tiles({place: partial(_payload, place, cells) for place, cells in changed.items()})


def tiles(occupancy: Occupancy) -> Iterator[tuple[tuple[int, int], Cells]]:
    """Yield column and row of each tile that an occupancy grid has known cells in, and its cells (TILE, TILE).

    The corner of the tile (0, 0) is the origin of the map.
    """
    first = np.rint(occupancy.origin / occupancy.resolution).astype(np.int64)  # x, y in cells from the map's origin
    low = first // TILE
    count = -(-(first + occupancy.cells.shape[::-1]) // TILE) - low
    padded = np.full((TILE * count[1], TILE * count[0]), UNKNOWN, dtype=np.int8)
    column, row = first - TILE * low
    padded[row : row + occupancy.cells.shape[0], column : column + occupancy.cells.shape[1]] = occupancy.cells
    for j in range(count[1]):
        for i in range(count[0]):
            cells = padded[TILE * j : TILE * (j + 1), TILE * i : TILE * (i + 1)]
            if (cells != UNKNOWN).any():
                yield (int(low[0]) + i, int(low[1]) + j), cells.copy()


def _payload(place: tuple[int, int], cells: Cells) -> dict[str, Any]:
    """Return a tile for the page: corner and side in metres, cells on a side, and the cells by rows, four in a byte.

    A cell has two bits, the lowest first: 0 unknown, 1 free, 2 occupied.
    """
    codes = np.zeros(cells.size, dtype=np.uint8)
    codes[cells.ravel() == FREE], codes[cells.ravel() == OCCUPIED] = 1, 2
    packed = (codes.reshape(-1, 4) << np.array([0, 2, 4, 6], dtype=np.uint8)).sum(axis=1).astype(np.uint8)
    side = TILE * RESOLUTION
    corner = {"x": round(place[0] * side, 6), "y": round(place[1] * side, 6)}
    return corner | {"size": side, "count": TILE, "cells": b64encode(packed.tobytes()).decode()}
