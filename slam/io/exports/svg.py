"""Write the map as an SVG drawing to the scale 1 : 100, or with measurements to the scale 1 : 50."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from ...formatting import percent
from ...geometry.segments import Floats
from ...measuring.measured_map import NOTHING_MEASURED, MeasuredMap
from ...measuring.openings import Opening
from ...measuring.rooms import Room
from ..run_results import RunResults
from .dimension_lines import AREA_TEXT_HEIGHT, TEXT_GAP, TEXT_HEIGHT, opening_text
from .scale_bar import SCALE_BAR_STYLE, draw_scale_bar
from .svg_drawing import PATH_CLASSES, UNKNOWN_CLASS, draw_map
from .text_placement import placed_areas, placed_dimensions

SCALE, MEASURED_SCALE = 100, 50
"""Scales 1 : n of drawings without and with measurements."""
STYLE = """
.confidence path { fill: currentColor; fill-opacity: .8; stroke: none }
.weak circle { fill: none; stroke: #d55e00; stroke-width: .06 }
.weak .drive { fill: none; stroke: #d55e00; stroke-width: .06; stroke-dasharray: .3 .2 }
.walls path { fill: none; stroke: #1f2933; stroke-width: .05; stroke-linecap: round }
.seen path { fill: #56b4e9; fill-opacity: .35 }
.corners ellipse { fill: #d55e00; fill-opacity: .2; stroke: #d55e00; stroke-width: .01 }
.corners .dot { stroke: #d55e00; stroke-width: .12; stroke-linecap: round }
.path polyline { fill: none; stroke-width: .04; stroke-linejoin: round }
.loops path { stroke: #009e73; stroke-width: .08 }
.loops .retracted { stroke: #d55e00; stroke-dasharray: .2 .2 }
.ends .start { fill: white; stroke: #0072b2; stroke-width: .06 }
.ends .end { fill: #0072b2 }
.rooms path { fill: #f0e442; fill-opacity: .15; fill-rule: evenodd }
.openings path { stroke: #0072b2; stroke-width: .03; stroke-dasharray: .08 .06 }
.dimensions path { stroke: #4d4d4d; stroke-width: .012; fill: none }
.dimensions text, .openings text { fill: #1f2933; stroke: white; stroke-width: .03; paint-order: stroke;
  text-anchor: middle; font-family: sans-serif }
"""
TICK = 0.06
"""Half the length of the strokes at the ends of a dimension line, metres."""


def write_svg(path: Path, results: RunResults, measured: MeasuredMap = NOTHING_MEASURED) -> None:
    """Write the drawing with the confidence map, or with rooms, openings and dimension lines of a measured map."""
    path.write_text(svg_text(results, measured), encoding="utf-8", newline="\n")


def svg_text(results: RunResults, measured: MeasuredMap = NOTHING_MEASURED) -> str:
    """Return the drawing as the text of an SVG file; see `write_svg`."""
    drawing = draw_map(results, confidence=measured is NOTHING_MEASURED)
    scale = SCALE if measured is NOTHING_MEASURED else MEASURED_SCALE
    bar = draw_scale_bar(drawing.left, drawing.top + drawing.height, drawing.width, 1e-3 * scale, f"1 : {scale}")
    above = [*_openings(measured.openings), *_dimensions(measured), bar.elements]
    elements = "\n".join([*_rooms(measured.rooms), drawing.elements, *above])
    colours = "".join(
        f".{c.name} {{ stroke: {c.colour}; color: {c.colour} }}\n" for c in (*PATH_CLASSES, UNKNOWN_CLASS)
    )
    size = drawing.width, drawing.height + bar.height
    width, height = (1e3 * metres / scale for metres in size)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.1f}mm" height="{height:.1f}mm" '
        f'viewBox="{drawing.left:.3f} {drawing.top:.3f} {size[0]:.3f} {size[1]:.3f}">\n'
        f"<title>{escape(str(results.summary.get('recording', 'map')))}</title>\n"
        f"<style>{STYLE}{SCALE_BAR_STYLE}{colours}</style>\n{elements}\n</svg>\n"
    )


def _rooms(rooms: Sequence[Room]) -> Iterator[str]:
    """Yield a group with the area of each room, without its islands."""
    if not rooms:
        return
    yield '<g class="rooms">'
    for room in rooms:
        rings = "".join(f"M{_points(part.vertices)}Z" for part in (room.outline, *room.islands))
        yield f'<path d="{rings}"><title>{room.name}: {percent(room.observed)} of the outline was seen</title></path>'
    yield "</g>"


def _openings(openings: Sequence[Opening]) -> Iterator[str]:
    """Yield a group with a line and a text for each door and passage."""
    if not openings:
        return
    yield '<g class="openings">'
    for opening in openings:
        walls = " and ".join(str(wall) for wall in opening.walls)
        yield f'<path d="M{_points(opening.ends)}"><title>{opening.name} in wall {walls}</title></path>'
        (x, y), text, angle = opening_text(opening)
        yield _text(x, -y, text, TEXT_HEIGHT, -float(np.degrees(angle)))
    yield "</g>"


def _points(points: Floats) -> str:
    """Return points (k, 2) of a path in SVG's axes."""
    return "L".join(f"{x:z.3f},{y:z.3f}" for x, y in points * [1.0, -1.0])


def _dimensions(measured: MeasuredMap) -> Iterator[str]:
    """Yield a group with a line with strokes at its ends for each length, and a text for each area."""
    if not measured.measurements:
        return
    yield '<g class="dimensions">'
    for one, (x, y) in placed_dimensions(measured):
        (x0, y0), (x1, y1) = one.line * [1.0, -1.0]
        (u0, v0), (u1, v1) = one.measured * [1.0, -1.0]
        dx, dy = TICK * np.array([y0 - y1, x1 - x0]) / np.hypot(x1 - x0, y1 - y0)
        ticks = "".join(f"M{u - dx:.3f},{v - dy:.3f}L{u + dx:.3f},{v + dy:.3f}" for u, v in ((x0, y0), (x1, y1)))
        extensions = f"M{u0:.3f},{v0:.3f}L{x0:.3f},{y0:.3f}M{u1:.3f},{v1:.3f}L{x1:.3f},{y1:.3f}"
        yield f'<path d="M{x0:.3f},{y0:.3f}L{x1:.3f},{y1:.3f}{ticks}{extensions}"><title>{one.identity}</title></path>'
        yield _text(x, -y, one.text, TEXT_HEIGHT, -float(np.degrees(one.angle)))
    for (x, y), text in placed_areas(measured):
        yield _text(x, -y, text, AREA_TEXT_HEIGHT)
    yield "</g>"


def _text(x: float, y: float, text: str, height: float, turn: float = 0.0) -> str:
    place = f"translate({x:.3f} {y:.3f})" + (f"rotate({turn:.2f})" if turn else "")
    return (
        f'<text transform="{place}" dy="{-TEXT_GAP * height:.4f}" font-size="{1.4 * height:.3f}">{escape(text)}</text>'
    )
