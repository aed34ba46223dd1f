"""Plot one scan and its extracted features."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from features.types import Features, Lines

from ...geometry.segments import Floats
from .style import BLUE, FAINT, INK, MUTED, VERMILLION, ellipses, legend, metric_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FULL_TURN_SHARE = 0.95
"""Share of a full turn above which the free space is drawn without the sensor as a vertex."""
LINE_NUMBER_OFFSET = 0.018
"""Distance of a line's number from the line, relative to the plot's larger extent."""


def plot_scan(path: Path, ranges: Floats, angles: Floats, features: Features, *, title: str) -> None:
    """Plot the returns of a scan (ranges (n,) metres, NaN for no-returns; angles (n,) radians), its lines and corners.

    Lines are numbered by their index in `features`. Raises OutputError.
    """
    valid = np.isfinite(ranges)
    points = ranges[valid, None] * np.stack([np.cos(angles[valid]), np.sin(angles[valid])], axis=-1)
    drawn = np.concatenate([points, np.zeros((1, 2))])
    subtitle = (
        f"{len(points)} returns, {len(features.lines)} lines, {len(features.corners)} corners, "
        f"range noise {1000 * features.noise.sigma_range:.1f} mm; frame of the lidar"
    )
    figure, axes = metric_figure(np.array([drawn.min(axis=0), drawn.max(axis=0)]), title, subtitle)
    full_turn = np.ptp(angles) > FULL_TURN_SHARE * 2 * np.pi
    axes.fill(*(points if full_turn else drawn).T, facecolor=FAINT, zorder=0)
    axes.plot(*points.T, ".", color=MUTED, markersize=3.0, markeredgewidth=0, label="return", zorder=2)
    _lines(axes, features.lines)
    if len(features.corners):
        name = ellipses(axes, features.corners.position, features.corners.covariance, VERMILLION, enlarged=True)
        axes.plot(*features.corners.position.T, ".", color=VERMILLION, markersize=4, label=f"corner, {name}", zorder=7)
    axes.plot(0, 0, marker=(3, 0, -90), color=INK, markersize=9, linestyle="", label="lidar, x ahead", zorder=8)
    legend(axes)
    save(figure, path)


def _lines(axes: Axes, lines: Lines) -> None:
    """Draw lines with rings at their ends, which separate neighbours, and numbers on the lidar's side."""
    offset = LINE_NUMBER_OFFSET * max(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
    for number, (start, end) in enumerate(zip(lines.start, lines.end, strict=True)):
        label = "line" if number == 0 else None
        ends = np.stack([start, end])
        axes.plot(*ends.T, color=BLUE, linewidth=1.5, solid_capstyle="butt", label=label, zorder=4)
        axes.plot(*ends.T, "o", color="white", markeredgecolor=BLUE, markersize=3.2, markeredgewidth=0.9, zorder=5)
        along = (end - start) / np.hypot(*(end - start))
        place = 0.5 * (start + end) + offset * np.array([-along[1], along[0]])
        axes.text(place[0], place[1], str(number), fontsize=7, color=BLUE, ha="center", va="center", zorder=9)
