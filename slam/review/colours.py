"""The colours of the review log, on a dark ground: one meaning each, told apart by colour-blind people.

Where two kinds share a colour they mean the same thing in two stages, and the later or weaker one is dashed or dimmer.
The legend tells people of them by their names.
"""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int] | tuple[int, int, int, int]

BACKGROUND: Colour = (18, 18, 24)
GRID: Colour = (255, 255, 255, 16)

WALL: Colour = (238, 238, 238)
WALL_FRESH: Colour = (150, 150, 158)
WALL_SIGMA: Colour = (85, 85, 95)
CORNER: Colour = (240, 228, 66)

ESTIMATE: Colour = (86, 180, 233)
ESTIMATE_SHADES: tuple[Colour, ...] = (ESTIMATE, (60, 126, 163), (39, 81, 105))  # the less certain the darker
ODOMETRY: Colour = (110, 110, 110)
TRUTH: Colour = (0, 190, 130)

SCAN: Colour = (165, 140, 255)
MATCHED: Colour = (255, 165, 0)
NEW: Colour = (255, 70, 200)

CLOSURE: Colour = (150, 255, 90)
REFUSED: Colour = (226, 88, 34)
BEFORE: Colour = (70, 95, 215)

# Series of one plot, in this order; a plot's legend names them.
SERIES: tuple[Colour, ...] = (
    (86, 180, 233),
    (255, 165, 0),
    (0, 190, 130),
    (255, 70, 200),
    (240, 228, 66),
    (165, 140, 255),
    (238, 238, 238),
    (226, 88, 34),
    (150, 150, 158),
)
