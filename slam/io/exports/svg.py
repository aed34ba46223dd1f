"""Write the map as an SVG drawing to the scale 1 : 100."""

from __future__ import annotations

from html import escape
from pathlib import Path

from ..run_results import RunResults
from .svg_drawing import PATH_CLASSES, UNKNOWN_CLASS, draw_map

MILLIMETRES_PER_METRE = 10
"""Millimetres of paper per metre of the map."""
STYLE = """
.walls path { fill: none; stroke: #1f2933; stroke-width: .05; stroke-linecap: round }
.seen path { fill: #56b4e9; fill-opacity: .35 }
.corners ellipse { fill: #d55e00; fill-opacity: .2; stroke: #d55e00; stroke-width: .01 }
.corners .dot { stroke: #d55e00; stroke-width: .12; stroke-linecap: round }
.path polyline { fill: none; stroke-width: .04; stroke-linejoin: round }
.loops path { stroke: #009e73; stroke-width: .08 }
.loops .retracted { stroke: #d55e00; stroke-dasharray: .2 .2 }
.ends .start { fill: white; stroke: #0072b2; stroke-width: .06 }
.ends .end { fill: #0072b2 }
"""


def write_svg(path: Path, results: RunResults) -> None:
    """Write the drawing."""
    drawing = draw_map(results)
    colours = "".join(f".{c.name} {{ stroke: {c.colour} }}\n" for c in (*PATH_CLASSES, UNKNOWN_CLASS))
    width, height = MILLIMETRES_PER_METRE * drawing.width, MILLIMETRES_PER_METRE * drawing.height
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.1f}mm" height="{height:.1f}mm" '
        f'viewBox="{drawing.view_box}">\n'
        f"<title>{escape(str(results.summary.get('recording', 'map')))}</title>\n"
        f"<style>{STYLE}{colours}</style>\n{drawing.elements}\n</svg>\n",
        encoding="utf-8",
        newline="\n",
    )
