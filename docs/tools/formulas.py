"""MkDocs hook that renders formulas as SVG within the page, so that a reader's browser fetches nothing.

In Markdown formulas stand between dollar signs, which GitHub renders as well. Matplotlib's mathtext draws them without
a colour, so that they are readable on light and dark backgrounds.
"""

from __future__ import annotations

import re
from functools import cache
from html import escape, unescape
from io import StringIO
from typing import Any

FORMULA = re.compile(r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<tex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL)
POINTS = 10.0
"""Font size of the drawing; the page scales it."""
UNWANTED = re.compile(r'<\?xml.*?<svg|<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>| id="\w+_1"', re.DOTALL)
"""Parts of the SVG file that do not belong into a page."""


def on_page_content(html: str, **_: Any) -> str:
    """Replace the formulas of a page; a formula that mathtext cannot parse is a build error."""
    return FORMULA.sub(_render, html)


def _render(match: re.Match[str]) -> str:
    tag, tex = match["tag"], " ".join(unescape(match["tex"]).split())
    svg, height, depth = _draw(tex.replace(r"\frac", r"\dfrac") if tag == "div" else tex)
    style = f"height:{height / POINTS:.3f}em;vertical-align:{-depth / POINTS:.3f}em"
    return f'<{tag} class="formula" role="img" aria-label="{escape(tex)}"><svg style="{style}" {svg}</{tag}>'


@cache
def _draw(tex: str) -> tuple[str, float, float]:
    """Return the SVG after `<svg`, its height, and its depth below the baseline in points."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import MathTextParser

    with rc_context({"mathtext.fontset": "cm", "svg.fonttype": "path", "svg.hashsalt": tex}):
        size = FontProperties(size=POINTS)
        width, height, depth, *_ = MathTextParser("path").parse(f"${tex}$", dpi=72, prop=size)
        figure = Figure(figsize=(width / 72, height / 72))
        figure.text(0, depth / height, f"${tex}$", fontproperties=size)
        file = StringIO()
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    return UNWANTED.sub("", file.getvalue()).strip(), height, depth
