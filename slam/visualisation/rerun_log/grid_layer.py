"""Draw the occupancy grid of the final map behind it, as one picture."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import rerun as rr

from ...errors import MapError
from ...io.exports import OccupancyGrid, PlacedScan
from ...io.exports.occupancy import FREE, OCCUPIED, UNKNOWN
from . import colours
from .rrd_writer import RrdWriter
from .shapes import Height, bounds

MAX_CELLS = 1_500_000
"""Cells of the picture; those of larger maps are larger."""


def log_grid(writer: RrdWriter, scans: Iterable[PlacedScan], resolution: float) -> None:
    """Log the grid of scans at the current time, with cells of at least `resolution` metres.

    Nothing is logged if no beam hit anything.
    """
    placed = list(scans)
    low, high = bounds(np.zeros((0, 2)), *(scan.points for scan in placed))
    grid = OccupancyGrid(max(resolution, float(np.sqrt(np.prod(high - low) / MAX_CELLS))))
    try:
        grid.add_all(placed)
        occupancy = grid.occupancy()
    except MapError:
        return
    picture = np.zeros((*occupancy.cells.shape, 3), dtype=np.uint8)  # the viewer does not show what is transparent
    for state, colour in ((UNKNOWN, colours.BACKGROUND), (FREE, colours.FREE), (OCCUPIED, colours.OCCUPIED)):
        picture[occupancy.cells == state] = colour
    rows, columns = occupancy.cells.shape
    layer = rr.GridMap(
        data=picture[::-1].tobytes(),  # the first row of a picture is the upper one
        format=rr.components.ImageFormat(
            width=columns, height=rows, color_model=rr.ColorModel.RGB, channel_datatype=rr.ChannelDatatype.U8
        ),
        cell_size=occupancy.resolution,
        translation=[*occupancy.origin.tolist(), float(Height.GRID)],
    )
    writer.log("world/grid", layer)
