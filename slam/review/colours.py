"""The colours of the review log, on a dark ground: one meaning each, safe for colour-blind people."""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int] | tuple[int, int, int, int]

BACKGROUND: Colour = (18, 18, 24)
GRID: Colour = (255, 255, 255, 16)

WALL: Colour = (238, 238, 238)
WALL_FRESH: Colour = (150, 150, 158)
WALL_SIGMA: Colour = (85, 85, 95)
CORNER: Colour = (240, 228, 66)
CORNER_SIGMA: Colour = (240, 228, 66, 110)

ESTIMATE: Colour = (86, 180, 233)
POSE_SIGMA: Colour = (86, 180, 233, 110)
ODOMETRY: Colour = (100, 100, 100)
TRUTH: Colour = (0, 190, 130)

SCAN: Colour = (165, 140, 255)
MATCHED: Colour = (255, 165, 0)
NEW: Colour = (255, 70, 200)
UNMATCHED: Colour = (190, 130, 100)

CLOSURE: Colour = (120, 255, 90)
REFUSED: Colour = (213, 94, 0)

# Series of one plot, in this order; a plot's legend names them.
SERIES: tuple[Colour, ...] = (
    (86, 180, 233),
    (255, 165, 0),
    (0, 190, 130),
    (255, 70, 200),
    (240, 228, 66),
    (165, 140, 255),
    (238, 238, 238),
    (213, 94, 0),
)
