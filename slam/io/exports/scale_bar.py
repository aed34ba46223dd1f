"""Draw a scale bar below an SVG drawing."""

from __future__ import annotations

from dataclasses import dataclass

LENGTHS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Metres that a bar may be long."""
MAX_SHARE = 0.25
"""Length of the bar at most, as a share of the drawing's width."""
TEXT, BAR = 2.5, 1.0
"""Heights of text (ISO 3098) and bar, millimetres of paper."""
SCALE_BAR_STYLE = """.scale path { fill: none; stroke: #1f2933 }
.scale text { fill: #1f2933; stroke: none; font-family: sans-serif }
"""


@dataclass(frozen=True, slots=True)
class ScaleBar:
    """SVG elements of a scale bar, and the height in metres of the map by which they enlarge the drawing."""

    elements: str
    height: float


def draw_scale_bar(left: float, bottom: float, width: float, millimetre: float, note: str = "") -> ScaleBar:
    """Draw a bar with its length below a drawing.

    left, bottom, width  of the drawing, metres in SVG's axes
    millimetre           metres of the map that are a millimetre of paper
    note                 text beside the length
    """
    length = max((one for one in LENGTHS if one <= MAX_SHARE * width), default=LENGTHS[0])
    x, y, end = left + 3.0 * millimetre, bottom + BAR * millimetre, BAR * millimetre
    bar = f"M{x:.3f},{y:.3f}v{end:.3f}h{length:g}v{-end:.3f}"
    text = f"{length:g} m" + (f", {note}" if note else "")
    height = 1.4 * TEXT * millimetre
    elements = (
        f'<g class="scale"><path style="stroke-width: {0.35 * millimetre:.4f}" d="{bar}"/>'
        f'<text x="{x:.3f}" y="{y + end + height:.3f}" style="font-size: {height:.3f}px">{text}</text></g>'
    )
    return ScaleBar(elements, 3.0 * BAR * millimetre + 1.5 * height)
