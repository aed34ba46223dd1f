"""Plot the errors of a trajectory, over time and as a distribution."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...evaluation.metrics import ReferenceScore, RelationsScore
from ...geometry.segments import Floats
from .style import (
    BLUE,
    DOTS_PER_INCH,
    GREEN,
    INK,
    MUTED,
    VERMILLION,
    add_titles,
    legend,
    metric_figure,
    save,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOG_SCALE_RATIO = 30
"""Largest error / median above which the scale is logarithmic, to show both."""


def plot_relations(path: Path, score: RelationsScore, *, title: str) -> None:
    """Plot the errors of relations over the time of their first pose, and their distribution. Raises OutputError."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.2), dpi=DOTS_PER_INCH, layout="constrained")
    (time_metres, share_metres), (time_degrees, share_degrees) = figure.subplots(
        2, 2, width_ratios=[3, 1.2], sharex="col"
    )
    figures = score.figures()
    seconds = score.first - score.first.min()
    rows = (
        (time_metres, share_metres, score.errors.translation, "translation, m", "trans", "m"),
        (time_degrees, share_degrees, np.degrees(score.errors.rotation), "rotation, degrees", "rot", "°"),
    )
    for over_time, shares, errors, name, key, unit in rows:
        mean = figures[f"{key}_mean"]
        over_time.plot(seconds, errors, ".", color=BLUE, markersize=3, markeredgewidth=0, alpha=0.6)
        over_time.axhline(mean, color=VERMILLION, linewidth=1.0)
        over_time.set_ylabel(name, fontsize=9, color=INK)
        _distribution(shares, errors)
        for axes in (over_time, shares):
            if errors.max() > LOG_SCALE_RATIO * np.median(errors) > 0:
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter("{x:g}")
            else:
                axes.set_ylim(bottom=0)
        shares.axhline(mean, color=VERMILLION, linewidth=1.0)
        shares.annotate(
            f"mean {mean:.3g} {unit}",
            (2, mean),
            xytext=(0, 4),
            textcoords="offset points",
            fontsize=8,
            color=VERMILLION,
        )
        style_axes(over_time)
        style_axes(shares)
    time_degrees.set_xlabel("time of the first pose, seconds", fontsize=9, color=INK)
    share_degrees.set_xlabel("% of the relations below", fontsize=9, color=INK)
    add_titles(time_metres, title, f"{figures['relations']} relations, {figures['missing']} outside the trajectory")
    save(figure, path)


def plot_reference(path: Path, score: ReferenceScore, *, title: str) -> None:
    """Plot the aligned trajectory over its reference, coloured by its distance to it. Raises OutputError."""
    from matplotlib.collections import LineCollection

    positions = score.aligned[:, :2]
    drawn = np.concatenate([positions, score.reference[:, :2]])
    figures = score.figures()
    subtitle = (
        f"absolute trajectory error {figures['ate_rmse']:.4g} m (root mean square after alignment), "
        f"largest {figures['ate_max']:.3g} m, {figures['poses']} poses"
    )
    figure, axes = metric_figure(np.array([drawn.min(axis=0), drawn.max(axis=0)]), title, subtitle)
    axes.plot(*score.reference[:, :2].T, color=GREEN, linewidth=4.0, alpha=0.25, label="reference")
    pieces = LineCollection(
        list(np.stack([positions[:-1], positions[1:]], axis=1)), cmap="cividis_r", linewidth=1.6, label="trajectory"
    )
    pieces.set_array(score.absolute.translation[1:])
    pieces.set_clim(0, None)
    axes.add_collection(pieces)
    bar = figure.colorbar(pieces, ax=axes, shrink=0.6, aspect=30, pad=0.02)
    bar.set_label("distance to the reference, m", fontsize=8, color=MUTED)
    bar.ax.tick_params(length=0, labelsize=8, labelcolor=MUTED)
    bar.outline.set_visible(False)
    legend(axes)
    save(figure, path)


def _distribution(axes: Axes, errors: Floats) -> None:
    """Plot the sorted errors: at p on the x axis, p per cent are smaller."""
    axes.plot(np.linspace(0, 100, len(errors)), np.sort(errors), color=BLUE, linewidth=1.4)
    axes.set_xlim(0, 100)
