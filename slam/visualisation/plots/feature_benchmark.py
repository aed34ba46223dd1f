"""Plot the accuracy of walls and corners over noise levels, for every segmentation and estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from features.benchmark.accuracy import Row

from .style import BLUE, DOTS_PER_INCH, GREEN, INK, MUTED, ORANGE, SKY, VERMILLION, add_titles, save, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (VERMILLION, BLUE, ORANGE, GREEN, SKY, MUTED)
"""Of the methods, in their order."""
EXPECTED_NEES = 2.0
"""Of two dimensions."""
MAX_NEES = 6.0
"""Largest value shown."""


def plot_features(path: Path, rooms: Sequence[Row], curved: Sequence[Row]) -> None:
    """Plot three panels: recall of corners, NEES of corners, false corners on curves. Raises OutputError."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 4.6), dpi=DOTS_PER_INCH, layout="constrained")
    recall, nees, curves = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 0.7))
    add_titles(recall, "Recall of corners", "share of the visible corners")
    _by_level(recall, rooms, lambda row: row.corner_recall)
    recall.set_ylim(0.0, 1.02)
    add_titles(nees, "Consistency", "mean NEES of corners; expected 2; above 6 not shown")
    _by_level(nees, rooms, lambda row: row.corner_nees if row.corner_nees <= MAX_NEES else np.nan)
    nees.axhline(EXPECTED_NEES, color=INK, linewidth=0.8, zorder=1)
    nees.set_ylim(0.0, MAX_NEES)
    add_titles(curves, "Curves", "false corners and lines on each")
    places = np.arange(len(curved))
    curves.bar(places - 0.2, [row.curved_lines for row in curved], 0.38, color=SKY, label="lines")
    curves.bar(places + 0.2, [row.curved_corners for row in curved], 0.38, color=VERMILLION, label="corners")
    curves.set_ylim(0.0, 1.15 * curves.get_ylim()[1])
    _name_levels(curves, [_level(row) for row in curved])
    curves.legend(frameon=False, fontsize=8.5, labelcolor=INK, loc="upper left", ncols=2)
    for axes in (recall, nees, curves):
        style_axes(axes)
    handles, labels = recall.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower left", ncols=len(labels), frameon=False, fontsize=8.5, labelcolor=INK
    )
    save(figure, path)


def _by_level(axes: Axes, rows: Sequence[Row], value: Callable[[Row], float]) -> None:
    """Plot a point for every method at every level, side by side."""
    levels = list(dict.fromkeys(_level(row) for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    for k, method in enumerate(methods):
        own = [row for row in rows if row.method == method]
        places = np.array([levels.index(_level(row)) for row in own]) + 0.11 * (k - 0.5 * (len(methods) - 1))
        axes.plot(places, [value(row) for row in own], "o", color=COLOURS[k % len(COLOURS)], markersize=5, label=method)
    _name_levels(axes, levels)


def _name_levels(axes: Axes, levels: Sequence[str]) -> None:
    axes.set_xticks(range(len(levels)), levels)


def _level(row: Row) -> str:
    noise = f"{100 * row.sigma_range:g} cm\n{np.degrees(row.sigma_bearing):.2f}°"
    return noise + (f"\n{100 * row.outliers:g} % out" if row.outliers else "")
