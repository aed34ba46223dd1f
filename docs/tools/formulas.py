"""Formulas as pictures within the page: mkdocs calls this for every page; nothing is fetched when it is read.

Markdown has them between dollar signs, as GitHub shows them too. What matplotlib's mathtext draws of them has no
colour of its own, so that it is readable on light and on dark ground.
"""

from __future__ import annotations

import re
from functools import cache
from html import escape, unescape
from io import StringIO
from typing import Any

FORMULA = re.compile(r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<tex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL)
POINTS = 10.0  # size that is drawn with; the page scales it
NOT_IN_A_PAGE = re.compile(
    r'<\?xml.*?<svg|<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>| id="\w+_1"', re.DOTALL
)


def on_page_content(html: str, **_: Any) -> str:
    """Replace the formulas of a page; a formula that mathtext does not understand is an error of the build."""
    return FORMULA.sub(_picture, html)


def _picture(match: re.Match[str]) -> str:
    tag, tex = match["tag"], " ".join(unescape(match["tex"]).split())
    svg, height, depth = _drawn(tex.replace(r"\frac", r"\dfrac") if tag == "div" else tex)
    style = f"height:{height / POINTS:.3f}em;vertical-align:{-depth / POINTS:.3f}em"
    return f'<{tag} class="formula" role="img" aria-label="{escape(tex)}"><svg style="{style}" {svg}</{tag}>'


@cache
def _drawn(tex: str) -> tuple[str, float, float]:
    """What follows `<svg`, and the height and the part of it below the line in points."""
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
    return NOT_IN_A_PAGE.sub("", file.getvalue()).strip(), height, depth
