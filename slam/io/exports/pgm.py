"""Write an occupancy grid as a binary PGM picture with a YAML file, as map_server of ROS 1 and of Nav2 loads them.

The first row of the picture is the largest y of the map, and `origin` is the position of its lower left corner. In
map_server's mode "trinary" a pixel p has the occupancy (255 - p) / 255: above `occupied_thresh` it is occupied, below
`free_thresh` free, in between unknown.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .occupancy import FREE, OCCUPIED, Occupancy

BLOCK = 256
"""Rows of the picture that are written at a time, so that it needs little memory beside the grid."""
PIXEL_OCCUPIED, PIXEL_UNKNOWN, PIXEL_FREE = 0, 205, 254
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""Defaults of map_saver. Unknown pixels have the occupancy 0.19608: with 0.25, the default of some Nav2 releases, they
would be read as free."""


def write_pgm(path: Path | str, occupancy: Occupancy) -> None:
    """Write the picture."""
    rows, columns = occupancy.cells.shape
    upside_down = occupancy.cells[::-1]
    with Path(path).open("wb") as file:
        file.write(b"P5\n%d %d\n255\n" % (columns, rows))
        for row in range(0, rows, BLOCK):
            block = upside_down[row : row + BLOCK]
            pixels: NDArray[np.uint8] = np.full(block.shape, PIXEL_UNKNOWN, dtype=np.uint8)
            pixels[block == FREE] = PIXEL_FREE
            pixels[block == OCCUPIED] = PIXEL_OCCUPIED
            file.write(pixels.tobytes())


def write_pgm_yaml(path: Path | str, occupancy: Occupancy, image: str) -> None:
    """Write the YAML file; `image` is the path of the picture relative to it."""
    x, y = occupancy.origin.tolist()
    Path(path).write_text(
        f"image: {json.dumps(image)}\n"
        "mode: trinary\n"
        f"resolution: {occupancy.resolution:.6f}\n"
        f"origin: [{x:z.6f}, {y:z.6f}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESHOLD}\n"
        f"free_thresh: {FREE_THRESHOLD}\n",
        encoding="utf-8",
        newline="\n",
    )
