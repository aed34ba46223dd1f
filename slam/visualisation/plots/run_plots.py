"""Plot single runs: errors against sigmas, a loop closure, and degenerate corridors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drivers import se2
from drivers.path_length import path_length

from ...events import LoopDecided, MapUpdated, StateChanged
from ...geometry.segments import Floats
from ...io.tum import Trajectory
from ...mapping.map_features import Keyframes
from .style import (
    BLUE,
    DOTS_PER_INCH,
    INK,
    MUTED,
    ORANGE,
    SIGMAS,
    SKY,
    VERMILLION,
    save,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEGEND: dict[str, Any] = {"frameon": False, "fontsize": 8.5, "labelcolor": INK}
CLOSURE_MARGIN = 0.8
"""Metres around map and path in the picture of a closure."""
CLOSURE_SIDE, CLOSURE_WIDTH = 6.0, 9.0
"""Inches: height of panels side by side, and width of panels one above the other."""
MAX_ASPECT_BESIDE = 1.5
"""Width / height from which on panels are one above the other."""
AXES = (("ahead, mm", 1e3), ("to the left, mm", 1e3), ("heading, degrees", float(np.degrees(1.0))))


def plot_consistency(path: Path, keyframes: Keyframes, truth: Trajectory, *, title: str) -> None:
    """Plot the keyframes' errors in their own frames with 3-sigma bands. Raises OutputError.

    Poses are compared relative to the first keyframe, which defines the map frame.
    """
    from matplotlib.figure import Figure

    _, errors = _errors(keyframes, truth)
    sigma = np.sqrt(np.diagonal(keyframes.covariance, axis1=1, axis2=2))
    seconds = keyframes.stamps - keyframes.stamps[0]
    figure = Figure(figsize=(9, 5.6), dpi=DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    panels: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    for k, (axes, (name, scale)) in enumerate(zip(panels, AXES, strict=True)):
        band, error = SIGMAS * scale * sigma[:, k], scale * errors[:, k]
        axes.fill_between(seconds, -band, band, color=SKY, alpha=0.3, linewidth=0, label="3σ of the estimate")
        axes.plot(seconds, error, color=BLUE, linewidth=1.0, label="error against ground truth")
        axes.set_ylabel(name, fontsize=9, color=INK)
        style_axes(axes)
        outside = 100 * float(np.mean(np.abs(error) > band))
        axes.set_title(f"{outside:.1f} % of the keyframes outside", loc="right", fontsize=8.5, color=MUTED)
    panels[-1].set_xlabel("seconds", fontsize=9, color=INK)
    panels[0].legend(loc="upper left", ncols=2, **LEGEND)
    save(figure, path)


def plot_closure(path: Path, decided: LoopDecided, after: MapUpdated) -> None:
    """Plot walls and path right before a loop closure and right after it, side by side or one above the other.

    Raises OutputError if the file cannot be written, ValueError if the decision corrected nothing.
    """
    from matplotlib.figure import Figure

    correction = decided.correction
    if correction is None:
        raise ValueError("the loop was not closed")
    walls = [correction.walls_before.piece_points()[0], after.walls.piece_points()[0]]
    paths = [correction.keyframe_poses_before[:, :2], after.keyframe_poses[:, :2]]
    drawn = np.concatenate([points.reshape(-1, 2) for points in (*walls, *paths)])
    low, high = drawn.min(axis=0) - CLOSURE_MARGIN, drawn.max(axis=0) + CLOSURE_MARGIN
    aspect = float((high - low)[0] / (high - low)[1])
    beside = aspect < MAX_ASPECT_BESIDE
    size = (CLOSURE_SIDE * aspect * 2, CLOSURE_SIDE) if beside else (CLOSURE_WIDTH, CLOSURE_WIDTH / aspect * 2)
    figure = Figure(figsize=(size[0] + 0.6, size[1] + 1.5), dpi=DOTS_PER_INCH, layout="constrained")
    title = f"A loop of {path_length(paths[0]):.0f} m is closed: the estimate moves by {decided.shift:.2f} m"
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    panels: Sequence[Axes] = figure.subplots(*((1, 2) if beside else (2, 1)), sharex=True, sharey=True)
    names = (
        "before: odometry and scans have drifted, so the same walls are there twice",
        f"after: {decided.matches} looks agreed on the place, {len(decided.merged)} pairs of walls are one again",
    )
    for axes, name, ends, positions in zip(panels, names, walls, paths, strict=True):
        axes.set_title(name, loc="left", fontsize=9, color=MUTED, pad=8)
        _draw_half(axes, ends, positions, decided.old)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        style_axes(axes)
    moved = np.array([paths[0][decided.index], paths[1][decided.index]])
    arrow = {"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 2}
    panels[0].annotate("", moved[1], moved[0], arrowprops=arrow, zorder=8)
    panels[0].plot([], [], color=VERMILLION, linewidth=2, label="correction")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=len(labels), **LEGEND)
    save(figure, path)


def _draw_half(axes: Axes, walls: Floats, path: Floats, old: int) -> None:
    """Draw walls (n, 2, 2) and path (k, 2), its last part in another colour: as long as the first up to `old`."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(walls), color=INK, linewidth=1.3, label="wall", zorder=5))
    axes.plot(*path.T, color=SKY, linewidth=1.3, label="path", zorder=4)
    axes.plot(
        *path[old], "o", color="white", markeredgecolor=BLUE, markersize=6, label="seen first from here", zorder=7
    )
    axes.plot(*path[-1], "o", color=BLUE, markersize=6, label="robot", zorder=7)


class CorridorRun(NamedTuple):
    """Run along a corridor in x: name, keyframes, true path, and changes of the localisation status."""

    name: str
    keyframes: Keyframes
    truth: Trajectory
    states: Sequence[StateChanged]


def plot_corridors(path: Path, corridors: Sequence[CorridorRun], *, title: str) -> None:
    """Plot errors along and across corridors, the sigma along them, and the time in status DEGENERATE.

    Raises OutputError.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2), dpi=DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    panels: Sequence[Axes] = figure.subplots(1, len(corridors), sharey=True)
    for axes, (name, keyframes, truth, states) in zip(panels, corridors, strict=True):
        seconds = keyframes.stamps - keyframes.stamps[0]
        ends = [*(later.stamp for later in states[1:]), keyframes.stamps[-1]]
        for change, end in zip(states, ends, strict=False):  # one end too many if the status never changed
            if change.state == "DEGENERATE":
                since, until = np.array([change.stamp, end]) - keyframes.stamps[0]
                axes.axvspan(since, until, color=ORANGE, alpha=0.15, linewidth=0)
        axes.fill_between([], [], [], color=ORANGE, alpha=0.15, linewidth=0, label="status DEGENERATE")
        relative, errors = _errors(keyframes, truth)
        c, s = np.cos(relative[:, 2]), np.sin(relative[:, 2])
        ahead, left = 1e3 * errors[:, 0], 1e3 * errors[:, 1]
        axes.plot(seconds, np.abs(c * ahead - s * left), color=VERMILLION, linewidth=1.4, label="error along")
        axes.plot(seconds, np.abs(s * ahead + c * left), color=BLUE, linewidth=1.4, label="error across")
        along = np.stack([c, -s], axis=1)
        sigma = np.sqrt(np.einsum("ki,kij,kj->k", along, keyframes.covariance[:, :2, :2], along))
        dashes: dict[str, Any] = {"color": INK, "linewidth": 1.2, "linestyle": (0, (3, 2))}
        axes.plot(seconds, 1e3 * SIGMAS * sigma, label="3σ along, of the estimate", **dashes)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_title(name, loc="left", fontsize=9, color=MUTED, pad=8)
        axes.set_xlabel("seconds", fontsize=9, color=INK)
        style_axes(axes)
    panels[0].set_ylim(bottom=0.1)  # shared by both panels, so set after all is drawn
    panels[0].set_ylabel("mm", fontsize=9, color=INK)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=len(labels), **LEGEND)
    save(figure, path)


def _errors(keyframes: Keyframes, truth: Trajectory) -> tuple[Floats, Floats]:
    """Return true poses (k, 3) relative to the first one, and errors (k, 3) in the keyframes' own frames."""
    actual = truth.at(keyframes.stamps).poses
    relative = se2.between(actual[0], actual)
    return relative, se2.between(relative, se2.between(keyframes.poses[0], keyframes.poses))
