"""The colours of the review log, on a dark ground: one meaning each, told apart by colour-blind people.

They were chosen to be as far apart as they can be in CIELAB for all kinds of colour vision, each near the colour that
its name says. Where two things share a colour they mean the same in two stages, and the later or weaker one is dashed
or dimmer. The legend tells people of them by their names.
"""

from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int] | tuple[int, int, int, int]

BACKGROUND: Colour = (18, 18, 24)
GRID: Colour = (255, 255, 255, 16)

WALL: Colour = (255, 255, 255)
CORNER: Colour = (240, 227, 0)
ESTIMATE: Colour = (107, 150, 253)
ODOMETRY: Colour = (93, 93, 93)
TRUTH: Colour = (23, 190, 111)
SCAN: Colour = (215, 185, 249)
MATCHED: Colour = (240, 137, 38)
NEW: Colour = (255, 75, 170)
CLOSURE: Colour = (129, 255, 140)
REFUSED: Colour = (190, 70, 38)
BEFORE: Colour = (30, 81, 226)
MEANINGFUL: tuple[Colour, ...] = (
    WALL, CORNER, ESTIMATE, ODOMETRY, TRUTH, SCAN, MATCHED, NEW, CLOSURE, REFUSED, BEFORE,
)  # fmt: skip

WALL_FRESH: Colour = (165, 165, 172)
WALL_SIGMA: Colour = (105, 105, 115)
ESTIMATE_SHADES: tuple[Colour, ...] = (ESTIMATE, (75, 105, 177), (48, 68, 114))  # the less certain the darker

# Series of one plot, in this order; a plot's legend names them.
SERIES: tuple[Colour, ...] = (ESTIMATE, MATCHED, TRUTH, NEW, CORNER, SCAN, WALL, REFUSED, WALL_FRESH)
