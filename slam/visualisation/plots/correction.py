"""Plot what a manual correction changes: the map around a place, before and after it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.segments import Floats
from ...io.run_results import RunResults
from .style import BLUE, DOTS_PER_INCH, INK, MUTED, SKY, VERMILLION, save, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REACH = 6.0
"""Metres around the place that are shown."""
PANEL_SIDE = 5.4
"""Inches."""


def plot_correction(
    path: Path, before: RunResults, after: RunResults, visits: tuple[int, int], texts: tuple[str, str], *, title: str
) -> None:
    """Plot a map before and after a correction around a place that was visited twice, side by side.

    before, after  results with keyframes
    visits         numbers of the keyframes of the earlier and the later visit, marked in both maps
    texts          above the maps

    Raises OutputError if the file cannot be written, ValueError if results have no keyframes.
    """
    from matplotlib.figure import Figure

    if before.keyframes is None or after.keyframes is None:
        raise ValueError("the results have no keyframes")
    figure = Figure(figsize=(2 * PANEL_SIDE, PANEL_SIDE + 1.2), dpi=DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    panels: Sequence[Axes] = figure.subplots(1, 2, sharex=True, sharey=True)
    paths = [results.keyframes.poses[:, :2] for results in (before, after) if results.keyframes is not None]
    both = [before.walls.identity, after.walls.identity]
    for axes, text, results, positions, others in zip(panels, texts, (before, after), paths, both[::-1], strict=True):
        axes.set_title(text, loc="left", fontsize=9, color=MUTED, pad=8)
        _draw_walls(axes, results, ~np.isin(results.walls.identity, others))
        _draw_path(axes, positions, visits)
        axes.set_aspect("equal")
        style_axes(axes)
    x, y = paths[0][list(visits)].mean(axis=0)
    panels[0].set(xlim=(x - REACH, x + REACH), ylim=(y - REACH, y + REACH))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower left", ncols=len(labels), frameon=False, fontsize=8.5, labelcolor=INK
    )
    save(figure, path)


def _draw_walls(axes: Axes, results: RunResults, own: NDArray[np.bool_]) -> None:
    """Draw the walls of a map; `own` (n,) are those whose identity the other map does not have."""
    from matplotlib.collections import LineCollection

    ends, rows = results.walls.piece_points()
    shared, single = (~own, INK, "wall with an identity of both maps"), (own, VERMILLION, "of this map only")
    for chosen, colour, name in (shared, single):
        lines = LineCollection(list(ends[chosen[rows]]), color=colour, linewidth=1.3, label=name, zorder=5)
        axes.add_collection(lines)


def _draw_path(axes: Axes, path: Floats, visits: tuple[int, int]) -> None:
    """Draw a path (k, 2), and mark the two visits."""
    axes.plot(*path.T, color=SKY, linewidth=1.0, label="path", zorder=4)
    mark: dict[str, Any] = {"marker": "o", "markersize": 6, "linestyle": "", "markeredgecolor": BLUE, "zorder": 7}
    for visit, colour in zip(visits, ("white", BLUE), strict=True):
        axes.plot(*path[visit], color=colour, label=f"keyframe {visit}", **mark)
