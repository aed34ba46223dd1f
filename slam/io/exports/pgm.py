"""A picture that map_server of ROS 1 and of Nav2 loads: a binary PGM and its YAML.

The picture's first row is the map's largest y, and `origin` is where its lower left corner lies, as map_server has it.
In its mode "trinary" a pixel p stands for the occupancy (255 - p) / 255: above `occupied_thresh` it is occupied, below
`free_thresh` free, else unknown.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .occupancy import FREE, OCCUPIED, Occupancy

PIXEL_OCCUPIED, PIXEL_UNKNOWN, PIXEL_FREE = 0, 205, 254
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""map_saver's. Unknown pixels stand for 0.19608, so with the 0.25 of some Nav2 releases they would read as free."""


def write_pgm(path: Path, occupancy: Occupancy) -> None:
    """Write the picture."""
    pixels: NDArray[np.uint8] = np.full(occupancy.cells.shape, PIXEL_UNKNOWN, dtype=np.uint8)
    pixels[occupancy.cells == FREE] = PIXEL_FREE
    pixels[occupancy.cells == OCCUPIED] = PIXEL_OCCUPIED
    rows, columns = occupancy.cells.shape
    path.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + pixels[::-1].tobytes())


def write_pgm_yaml(path: Path, occupancy: Occupancy, image: str) -> None:
    """Write what map_server reads first; `image` is the picture's name, as seen from this file."""
    x, y = occupancy.origin.tolist()
    path.write_text(
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
