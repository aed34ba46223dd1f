"""Fewer points of a path for drawing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..tum import Floats, distance_along

SPACING = 0.1  # metres: what is drawn of a building does not show less
MOST_POINTS = 20_000  # of a very long path, so that files stay small


def thinned(poses: Floats) -> NDArray[np.intp]:
    """Which of the poses (n, 3) to draw: the first, one each SPACING metres of driving or more, and the last."""
    travelled = distance_along(poses[:, :2])
    spacing = max(SPACING, float(travelled[-1]) / MOST_POINTS)
    first_in_each = np.unique(np.floor(travelled / spacing), return_index=True)[1]
    return np.unique(np.append(first_in_each, len(poses) - 1))
