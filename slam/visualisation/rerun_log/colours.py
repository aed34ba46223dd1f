"""Colours of the review log on a dark background: one meaning each, distinguishable with colour-vision deficiency.

They were chosen to be as far apart as possible in CIELAB for all kinds of colour vision, each near the colour that its
name in the legend says. Things that share a colour are two stages of the same thing; the later or weaker one is dashed
or dimmer.
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
GROUND_TRUTH: Colour = (23, 190, 111)
SCAN: Colour = (215, 185, 249)
MATCHED: Colour = (240, 137, 38)
NEW: Colour = (255, 75, 170)
CLOSURE: Colour = (129, 255, 140)
CONTRADICTION: Colour = (190, 70, 38)
BEFORE: Colour = (30, 81, 226)
DISTINCT_COLOURS: tuple[Colour, ...] = (
    WALL, CORNER, ESTIMATE, ODOMETRY, GROUND_TRUTH, SCAN, MATCHED, NEW, CLOSURE, CONTRADICTION, BEFORE,
)  # fmt: skip

WALL_NEW: Colour = (165, 165, 172)
WALL_SIGMA: Colour = (105, 105, 115)
BACKDROP: Colour = (117, 101, 136)  # scans of past keyframes: dim lavender
FREE: Colour = (44, 46, 60)  # cells of the occupancy grid, dim as the map is drawn over them
OCCUPIED: Colour = (96, 98, 112)
CONFIDENCE: tuple[Colour, ...] = ((86, 180, 233), (0, 158, 115), (240, 228, 66), (230, 159, 0), (213, 94, 0))
"""Bands of the confidence map, from the most certain on (limits: 2, 5, 10, 20 cm): Okabe and Ito (2008)."""
ESTIMATE_SHADES: tuple[Colour, ...] = (ESTIMATE, (75, 105, 177), (48, 68, 114))  # darker: less certain

# Series of one plot, in this order; the plot's legend names them.
SERIES: tuple[Colour, ...] = (ESTIMATE, MATCHED, GROUND_TRUTH, NEW, CORNER, SCAN, WALL, CONTRADICTION, WALL_NEW)
