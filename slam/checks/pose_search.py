"""Search for the best pose around another one on a grid, and on finer grids around the best so far."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers import se2

from ..geometry.segments import Floats

# Poses along each axis of the first grid and of the finer ones, and the half widths of these relative to the one
# before. Origin: numerical, steps of the first grid stay within the reach of what is compared.
FIRST_GRID, FINER_GRID, FINER_WIDTHS = 9, 5, (0.25, 0.5)


def search_pose(score: Callable[[Floats], Floats], start: se2.Pose, half_width: Floats) -> se2.Pose:
    """Return the pose (3,) whose score is largest.

    score       scores (m,) of poses (m, 3)
    start       (3,) middle of the grid
    half_width  (3,) of the first grid along x and y (metres), and in heading (radians)
    """
    best, width = start, half_width
    for count, scale in ((FIRST_GRID, 1.0), *((FINER_GRID, scale) for scale in FINER_WIDTHS)):
        width = scale * width
        offsets = (np.linspace(-extent, extent, count) for extent in width)
        poses = best + np.stack(np.meshgrid(*offsets, indexing="ij"), axis=-1).reshape(-1, 3)
        best = poses[int(np.argmax(score(poses)))]
    return best
