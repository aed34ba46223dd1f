"""Plots of the paper benchmark: environments, Figure 5, Siadat's columns, the threshold of tracking."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...evaluation.benchmarks.paper.environments import PAPER_NOISE, Environment
from ...evaluation.benchmarks.paper.numbers import TABLE_1, TABLE_2, THRESHOLD
from ...evaluation.benchmarks.paper.run import environments
from ...evaluation.benchmarks.paper.timing import FORMS
from ...evaluation.benchmarks.paper.uncertainty import CLEAR
from ...geometry.segments import Floats
from .style import (
    BLUE,
    DOTS_PER_INCH,
    FAINT,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    add_titles,
    legend,
    metric_figure,
    save,
    style_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"wclm": BLUE, "arras-siegwart": ORANGE, "siadat": GREEN, "wclm-ml": VERMILLION}
NAMES = {"wclm": "WCLM", "arras-siegwart": "Arras-Siegwart", "siadat": "Siadat", "wclm-ml": "WCLM-ML"}
WIDTHS = {"arras-siegwart": 5.0, "siadat": 3.0, "wclm": 1.2, "wclm-ml": 1.2}
"""Line widths, points (1/72 inch), of curves that coincide, in the order of drawing."""
NUMBER_OFFSET = 0.022
"""Distance of a corner's number from the corner, relative to the room's length."""
LEGEND: dict[str, Any] = {"frameon": False, "fontsize": 8.5, "labelcolor": INK}
LEGEND_ROW = 0.04
"""Height of a legend row relative to Figure 5."""
PANEL = 3.1
"""Side of a panel, inches."""


def plot_paper(folder: Path, measured: dict[str, Any], times: dict[str, Any]) -> list[Path]:
    """Draw all plots into an existing directory and return their paths. Raises OutputError."""
    worlds = environments()
    paths = [folder / f"{name}.png" for name in ("environment-a", "environment-b", "figure-5", "siadat", "tracking")]
    plot_environment(paths[0], worlds["A"], measured["seed"])
    plot_environment(paths[1], worlds["B"], measured["seed"])
    plot_points(paths[2], measured["figure_5"], times)
    plot_siadat(paths[3], measured["environments"])
    plot_tracking(paths[4], measured["tracking"])
    return paths


def plot_environment(path: Path, environment: Environment, seed: int) -> None:
    """Plot Figure 3 or 4: one sweep with the paper's noise, its walls, and the numbered corners."""
    heading = environment.sensor[2]
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])

    def placed(ranges: Floats, angles: Floats) -> Floats:
        points = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.asarray(points @ turn + environment.sensor[:2])

    walls = environment.world.segments.reshape(-1, 2)
    title = f"Environment {environment.name}, reconstructed"
    subtitle = (
        f"{len(environment.angles)} points, {len(environment.segments)} segments, {len(environment.corners)} corners; "
        f"range noise {1e3 * PAPER_NOISE.sigma_range:.0f} mm, bearing noise "
        f"{np.degrees(PAPER_NOISE.sigma_bearing):.4f}°"
    )
    figure, axes = metric_figure(np.array([walls.min(axis=0), walls.max(axis=0)]), title, subtitle)
    measured = environment.measure(np.random.default_rng(seed))
    axes.plot(*placed(measured, environment.angles).T, ".", color=MUTED, markersize=3, label="return", zorder=2)
    for number, segment in enumerate(environment.segments):
        ends = placed(environment.ranges[segment.rays], environment.angles[segment.rays])
        label = "true segment" if number == 0 else None
        axes.plot(*ends.T, color=SKY, linewidth=2.0, solid_capstyle="butt", label=label, zorder=3)
    corners = environment.positions @ turn + environment.sensor[:2]
    axes.plot(*corners.T, "^", color=INK, markersize=5, linestyle="", label="corner", zorder=5)
    axes.plot(*environment.sensor[:2], "x", color=VERMILLION, markersize=9, linestyle="", label="sensor", zorder=5)
    inwards = environment.sensor[:2] - corners
    inwards *= NUMBER_OFFSET * np.ptp(walls[:, 0]) / np.linalg.norm(inwards, axis=1)[:, None]
    for number, (x, y) in enumerate(corners + inwards, start=1):
        axes.text(x, y, str(number), fontsize=8, color=INK, ha="center", va="center", zorder=6)
    legend(axes)
    save(figure, path)


def plot_points(path: Path, curves: dict[str, Any], times: dict[str, Any]) -> None:
    """Plot Figure 5: uncertainty of four corners by the number of points, and below the times relative to WCLM."""
    figure, panels = _panels(2, len(curves), sharey="row")
    for column, (name, curve) in enumerate(curves.items()):
        upper, lower = panels[0][column], panels[1][column]
        for method, width in WIDTHS.items():
            for axis, dashes in ((0, "-"), (1, "--")):
                sigma = np.array(curve["sigma"][method])[:, axis]
                label = f"{NAMES[method]}, {'xy'[axis]}"
                upper.plot(curve["points"], sigma, dashes, label=label, color=COLOURS[method], linewidth=width)
        rows = times[name]
        points = [row["points"] for row in rows]
        wclm, double, single, siadat = ([row["numpy"][form] for row in rows] for form in FORMS)
        for label, form, colour, dashes in (
            ("Arras-Siegwart, double sums as printed", double, ORANGE, "-"),
            ("Arras-Siegwart, single sums", single, ORANGE, "--"),
            ("Siadat", siadat, GREEN, "-"),
        ):
            lower.plot(points, np.array(form) / wclm, dashes, color=colour, linewidth=1.6, label=label)
        lower.axhline(1.0, color=BLUE, linewidth=1.2, label="WCLM")
        upper.set_yscale("log")
        lower.set_yscale("log")
        for axes, ticks in ((upper, (5, 10, 20, 50)), (lower, (1, 2, 4, 8))):
            axes.set_yticks(ticks, [str(tick) for tick in ticks])
            axes.minorticks_off()
        lower.set_xlabel("points used", fontsize=8, color=MUTED)
        upper.set_title(f"corner {name[1:]} of {name[0]}", fontsize=10, color=INK, loc="left")
    panels[0][0].set_ylabel("standard deviation, mm", fontsize=8, color=MUTED)
    panels[1][0].set_ylabel("time / WCLM's time, NumPy", fontsize=8, color=MUTED)
    _title(figure, "Figure 5: uncertainty and time by the number of points")
    for row, below in ((panels[0], 0.0), (panels[1], LEGEND_ROW)):
        handles, labels = row[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.02, -below), ncols=8, **LEGEND)
    save(figure, path)


def plot_siadat(path: Path, worlds: dict[str, Any]) -> None:
    """Plot the excess of the paper's Siadat columns over Arras-Siegwart's, and the noise of one range."""
    figure, panels = _panels(1, 1, width=7.5, height=3.8)
    axes = panels[0][0]
    for table, name, colour in ((TABLE_1, "A", BLUE), (TABLE_2, "B", VERMILLION)):
        variance = np.sum(table[:, 1:].reshape(-1, 3, 2) ** 2, axis=2)
        excess = variance[:, 2] - variance[:, 1]
        more = excess > 0.0
        axes.plot(
            np.sqrt(variance[more, 1]),
            np.sqrt(excess[more]),
            "o",
            color=colour,
            markersize=5,
            label=f"environment {name}",
        )
    noise = 1e3 * PAPER_NOISE.sigma_range
    axes.axhline(noise, color=INK, linewidth=1.2, label="noise of one range")
    axes.set_xscale("log")
    axes.set_yscale("log")
    for side in (axes.set_xticks, axes.set_yticks):
        side((10, 20, 50, 100, 200), ["10", "20", "50", "100", "200"])
    axes.minorticks_off()
    axes.set_xlabel(
        "Arras-Siegwart's standard deviation in the paper's tables, x and y together, mm", fontsize=8, color=MUTED
    )
    axes.set_ylabel("Siadat's excess, in quadrature, mm", fontsize=8, color=MUTED)
    negative = sum(
        int((np.diff(np.sum(t[:, 3:].reshape(-1, 2, 2) ** 2, axis=2)) <= 0).sum()) for t in (TABLE_1, TABLE_2)
    )
    clear = sum(world["siadat's excess in the paper"]["corners"] for world in worlds.values())
    add_titles(
        axes,
        "Excess of the paper's Siadat columns",
        f"Tables I and II; clear below {CLEAR:.0f} mm ({clear} corners); without {negative} corners of negative excess",
    )
    legend(axes)
    save(figure, path)


def plot_tracking(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Plot the walls and corners found by the paper's tracking and by this project's segmentation, by range noise."""
    figure, panels = _panels(1, 2, sharey="row", width=3.8, height=3.4)
    bearings = sorted({row["sigma_bearing"] for row in rows})
    for axes, bearing in zip(panels[0], bearings, strict=True):
        selected = [row for row in rows if row["sigma_bearing"] == bearing]
        sigma = 1e3 * np.array([row["sigma_range"] for row in selected])
        for method, name, colour in (("tracking", "tracking", VERMILLION), ("split", "splitting", BLUE)):
            for what, dashes in (("walls", "-"), ("corners", "--")):
                share = 100 * np.array([row[method][what] for row in selected])
                axes.plot(sigma, share, f"{dashes}o", color=colour, markersize=3.5, label=f"{what}, {name}")
        axes.axvline(1e3 * PAPER_NOISE.sigma_range, color=INK, linewidth=1.0, label="the paper's range noise")
        axes.set_xscale("log")
        axes.set_xticks((1, 2, 5, 10, 20, 50), ["1", "2", "5", "10", "20", "50"])
        axes.minorticks_off()
        axes.set_ylim(-3, 103)
        axes.set_xlabel("standard deviation of range, mm", fontsize=8, color=MUTED)
        axes.set_title(f"bearing noise {np.degrees(bearing):.4g}°", fontsize=10, color=INK, loc="left")
    panels[0][0].set_ylabel("found, %", fontsize=8, color=MUTED)
    _title(figure, f"Walls and corners found by tracking with a threshold of {1e3 * THRESHOLD:.0f} mm")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.02, 0.0), ncols=3, **LEGEND)
    save(figure, path)


def _panels(
    rows: int, columns: int, *, sharey: Literal["none", "row"] = "none", width: float = PANEL, height: float = PANEL
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure and its styled axes by row and column."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * columns, height * rows), dpi=DOTS_PER_INCH, layout="constrained")
    grid = figure.subplots(rows, columns, sharey=sharey, squeeze=False)
    for axes in grid.flat:
        style_axes(axes)
        axes.set_facecolor(FAINT)
    return figure, grid.tolist()


def _title(figure: Figure, text: str) -> None:
    figure.suptitle(text, x=0.02, ha="left", fontsize=13, fontweight="bold", color=INK)
