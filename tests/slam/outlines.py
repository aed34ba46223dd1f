"""Synthetic scan points for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.geometry.segments import Floats

SPACING = 0.02  # metres between neighbouring points


def outline(corners: Sequence[tuple[float, float]]) -> Floats:
    """Return points (n, 2) every two centimetres along the sides of a polygon with these corners, metres."""
    ends = np.array(corners, dtype=np.float64)
    sides = zip(ends, np.roll(ends, -1, axis=0), strict=True)
    return np.concatenate([np.linspace(a, b, int(np.hypot(*(b - a)) / SPACING)) for a, b in sides])
