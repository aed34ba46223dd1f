"""Embed walls with their joint covariance in the page, from which its script measures two chosen walls."""

from __future__ import annotations

import json
from base64 import b64encode

import numpy as np

from features.corner_angle import MIN_SINE

from ...measuring.wall_map import WallMap


def joint_element(wall_map: WallMap | None) -> str:
    """Return an element with the walls as JSON; empty without them.

    The upper triangle of the covariance, row by row, is in base64 as little-endian 32-bit floats: 1.7 MB for 400 walls.
    """
    if wall_map is None:
        return ""
    walls = wall_map.walls
    upper = wall_map.covariance[np.triu_indices(len(wall_map.covariance))]
    data = {
        "identity": walls.identity.tolist(),
        "frame": walls.frame.tolist(),
        "low": walls.low.tolist(),
        "high": walls.high.tolist(),
        "minSine": MIN_SINE,
        "covariance": b64encode(upper.astype("<f4").tobytes()).decode(),
    }
    return f'<script type="application/json" id="joint">{json.dumps(data)}</script>\n'
