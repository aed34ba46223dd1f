"""Thin out a driven path for drawing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...geometry.segments import Floats
from ..tum import distance_along

MIN_SPACING = 0.1
"""Metres between two drawn points: invisible in the drawing of a building."""
MAX_POINTS = 20_000
"""Points of a very long path, approximately; limits the size of the file."""


def thin_path(poses: Floats) -> NDArray[np.intp]:
    """Return the rows of the poses (n, 3) to draw: the first, one per MIN_SPACING or more driven, and the last."""
    travelled = distance_along(poses[:, :2])
    spacing = max(MIN_SPACING, float(travelled[-1]) / MAX_POINTS)
    first_in_each = np.unique(np.floor(travelled / spacing), return_index=True)[1]
    return np.unique(np.append(first_in_each, len(poses) - 1))
