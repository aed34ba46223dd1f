"""Shared style of all plots: colours, metric axes, scale bar, ellipses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import OutputError
from ...geometry.segments import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# After Okabe and Ito: distinguishable with colour-vision deficiency, and by lightness in print.
INK = "#1f2933"
MUTED = "#6b7785"
GRID = "#e4e8ec"
FAINT = "#f4f6f8"
BLUE = "#0072b2"
SKY = "#56b4e9"
ORANGE = "#e69f00"
VERMILLION = "#d55e00"
PURPLE = "#cc79a7"
GREEN = "#009e73"

DOTS_PER_INCH = 160
MAX_SIDE = 10.5
MIN_SIDE = 4.2
"""Inches of the axes; the minimum leaves room for title and legend of a long and narrow map."""
MARGIN = 0.04
"""Free space around the content, relative to its larger extent."""
MAX_GRID_LINES = 14
"""Along the longer side, approximately."""
GRID_STEPS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
POINTS_PER_INCH = 72
TITLE_SIZE = 13
"""Points."""
SCALE_BAR_BELOW = 30
LEGEND_BELOW = 38
"""Distances below the axes, points (1/72 inch)."""
LEGEND_COLUMN = 2.6
"""Width of a legend column, inches."""
MIN_VISIBLE = 0.004
"""Smallest visible half axis of an ellipse, relative to the plot's larger extent."""
SIGMAS = 3.0


def metric_figure(bounds: Floats, title: str, subtitle: str) -> tuple[Figure, Axes]:
    """Return a figure and axes that show `bounds` ((2, 2): lowest and highest x, y in metres) true to scale."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MultipleLocator

    low, high = bounds
    extent = np.maximum(high - low, 1.0)
    low, high = (low + high - extent) / 2, (low + high + extent) / 2
    margin = MARGIN * extent.max()
    width, height = extent + 2 * margin
    inches = MAX_SIDE / max(width, height)
    size = max(width * inches, MIN_SIDE, _width(title)), max(height * inches, MIN_SIDE)
    figure = Figure(figsize=(size[0] + 0.8, size[1] + 1.6), dpi=DOTS_PER_INCH, layout="constrained")
    axes = figure.add_subplot()
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal", adjustable="box", anchor="W")
    step = next((s for s in GRID_STEPS if max(width, height) / s <= MAX_GRID_LINES), GRID_STEPS[-1])
    axes.xaxis.set_major_locator(MultipleLocator(step))
    axes.yaxis.set_major_locator(MultipleLocator(step))
    style_axes(axes)
    add_titles(axes, title, subtitle)
    _scale_bar(axes, step)
    return figure, axes


def style_axes(axes: Axes) -> None:
    """Set a light grid behind the content, no box, and small labels."""
    axes.set_axisbelow(True)
    axes.grid(True, color=GRID, linewidth=0.7)
    axes.tick_params(which="both", length=0, labelsize=8, labelcolor=MUTED)
    for spine in axes.spines.values():
        spine.set_visible(False)


def add_titles(axes: Axes, title: str, subtitle: str) -> None:
    """Set a title at the upper left, with a smaller subtitle below."""
    axes.set_title(subtitle, loc="left", fontsize=9, color=MUTED, pad=8)
    axes.annotate(
        title,
        xy=(0, 1),
        xycoords="axes fraction",
        xytext=(0, 24),
        textcoords="offset points",
        fontsize=TITLE_SIZE,
        fontweight="bold",
        color=INK,
    )


def _width(title: str) -> float:
    """Return the width of a title, inches: without room for a long one, the layout leaves none for the axes."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    outline = TextPath((0.0, 0.0), title, size=TITLE_SIZE, prop=FontProperties(weight="bold"))
    return float(outline.get_extents().width) / POINTS_PER_INCH if title.strip() else 0.0


def _scale_bar(axes: Axes, length: float) -> None:
    """Draw one grid step as a bar below the plot, at the right."""
    from matplotlib.transforms import ScaledTranslation

    right = axes.get_xlim()[1]
    down = ScaledTranslation(0, -SCALE_BAR_BELOW / POINTS_PER_INCH, axes.figure.dpi_scale_trans)
    style: dict[str, Any] = {"transform": axes.get_xaxis_transform() + down, "clip_on": False, "color": INK}
    axes.plot([right - length, right], [0, 0], linewidth=2.2, solid_capstyle="butt", **style)
    axes.text(right - length / 2, 0, f"{length:g} m\n", ha="center", va="center", fontsize=8, **style)


def legend(axes: Axes) -> None:
    """Draw the legend in rows below the plot."""
    from matplotlib.transforms import ScaledTranslation

    width = axes.figure.bbox.width / DOTS_PER_INCH
    down = ScaledTranslation(0, -LEGEND_BELOW / POINTS_PER_INCH, axes.figure.dpi_scale_trans)
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(0, 0),
        bbox_transform=axes.transAxes + down,
        ncols=max(1, int(width / LEGEND_COLUMN)),
        borderaxespad=0,
        borderpad=0,
        frameon=False,
        fontsize=8.5,
        labelcolor=INK,
        handlelength=1.8,
    )


def ellipses(
    axes: Axes, centres: Floats, covariances: Floats, colour: str, *, enlarged: bool, largest: float = np.inf
) -> str:
    """Draw 3-sigma ellipses at `centres` (n, 2) and return their name for the legend.

    If `enlarged`, all are enlarged by one round factor if they would be invisible, which the name states. In a map the
    uncertain ones would cover rooms then. Covariances (n, 2, 2) that are not finite are skipped, and ellipses that have
    a half axis above `largest` metres.
    """
    from matplotlib.collections import PolyCollection

    known = np.isfinite(covariances).all(axis=(1, 2))
    variances, directions = np.linalg.eigh(covariances[known])
    half_axes = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    extent = max(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
    typical = float(np.median(half_axes[:, 1])) if known.any() else 0.0
    factors = (1, 2, 5, 10, 20, 50) if enlarged else (1,)
    factor = next((f for f in factors if f * typical >= MIN_VISIBLE * extent), 100 if enlarged else 1)
    angle = np.linspace(0, 2 * np.pi, 49)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    outlines = directions @ (factor * half_axes[..., None] * circle)
    outlines = (centres[known][:, None, :] + outlines.transpose(0, 2, 1))[half_axes[:, 1] <= largest]
    axes.add_collection(
        PolyCollection(list(outlines), facecolor=(*_rgb(colour), 0.15), edgecolor=colour, linewidth=0.8, zorder=6)
    )
    return "3σ ellipse" if factor == 1 else f"3σ ellipse, drawn {factor} times larger"


def save(figure: Figure, path: Path) -> None:
    """Write the plot. Raises OutputError if it cannot be written."""
    try:
        figure.savefig(path, format="png", bbox_inches="tight", pad_inches=0.2, facecolor="white")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)
