"""Plots for the documentation of the mathematics: the line fit, and its covariance against Monte Carlo errors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from features import Noise

from ...evaluation.benchmarks.monte_carlo import (
    FIT,
    NOISE,
    TRIALS,
    Cloud,
    Wall,
    corner_positions,
    deviations,
    line_parameters,
)
from ...geometry.segments import Floats
from .style import BLUE, DOTS_PER_INCH, INK, MUTED, ORANGE, SKY, VERMILLION, save, style_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEGEND: dict[str, Any] = {"frameon": False, "fontsize": 8.5, "labelcolor": INK}
FIGURE_WIDTH = 9.0
"""Inches; small, so that text is large relative to the plot."""
RADIUS_95 = 2.448
"""Radius, in standard deviations, of the circle that contains 95 % in two dimensions."""
SIGMAS_95 = 1.96
SHOWN_FITS = 60
"""Fits drawn individually."""
DOT: dict[str, Any] = {"marker": ".", "linestyle": "", "markersize": 2.0, "markeredgewidth": 0, "alpha": 0.35}


def _panels(columns: int, title: str, height: float = 3.8) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(FIGURE_WIDTH, height), dpi=DOTS_PER_INCH, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold", color=INK)
    panels = list(np.atleast_1d(figure.subplots(1, columns)))
    for axes in panels:
        style_axes(axes)
    return figure, panels


def _label(axes: Axes, subtitle: str, x: str, y: str) -> None:
    axes.set_title(subtitle, loc="left", fontsize=9, color=MUTED, pad=8)
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)


def plot_inversion(path: Path, seed: int = 0) -> None:
    """Plot a wall in the plane, and the same rays as 1 / range over bearing, with the fit. Raises OutputError."""
    noise = Noise(sigma_range=0.08, sigma_bearing=NOISE.sigma_bearing)
    wall = Wall(2.0, np.radians(70.0), np.radians(5.0), np.radians(130.0))
    random = np.random.default_rng(seed)
    every = slice(None, None, 6)
    bearings, ranges = wall.bearings[every], wall.measure(random, noise)[every]
    figure, (plane, inverse) = _panels(2, "The inverse range is linear in (cos θ, sin θ)")
    points = ranges[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    ends = wall.points(wall.span)
    for point in points:
        plane.plot([0, point[0]], [0, point[1]], color=SKY, linewidth=0.5, alpha=0.6, zorder=1)
    plane.plot(*ends.T, color=INK, linewidth=1.6, label="wall", zorder=2)
    plane.plot(*points.T, ".", color=BLUE, markersize=6, label=f"return, range noise {100 * noise.sigma_range:.0f} cm")
    closest = wall.points(np.zeros(1))[0]
    plane.plot([0, closest[0]], [0, closest[1]], color=VERMILLION, linewidth=1.4, label="closest point, at d and α")
    plane.plot(*closest, "o", color=VERMILLION, markersize=5)
    plane.plot(0, 0, marker=(3, 0, -90), color=INK, markersize=9, linestyle="", label="lidar")
    plane.set_aspect("equal", adjustable="datalim")
    plane.legend(loc="upper right", **LEGEND)
    _label(plane, "in the plane", "x, metres", "y, metres")
    u, v = FIT(ranges, bearings, noise).uv
    fine = np.linspace(wall.low, wall.high, 200)
    error = np.hypot(noise.sigma_range / ranges**2, noise.sigma_bearing * (v * np.cos(bearings) - u * np.sin(bearings)))
    bars: dict[str, Any] = {"fmt": ".", "color": BLUE, "markersize": 6, "elinewidth": 1.0}
    inverse.errorbar(np.degrees(bearings), 1 / ranges, error, label="return and its standard deviation", **bars)
    label = f"fit: {u:.3f} cos θ + {v:.3f} sin θ"
    inverse.plot(np.degrees(fine), u * np.cos(fine) + v * np.sin(fine), color=INK, linewidth=1.6, label=label)
    inverse.legend(loc="lower center", **LEGEND)
    _label(inverse, "the fit", "bearing θ, degrees", "1 / range, 1/metres")
    save(figure, path)


def plot_fit(path: Path, seed: int = 0) -> None:
    """Plot the offsets of fitted walls from the true ones, and the 95 % band of one fit. Raises OutputError."""
    cases = (
        ("seen head-on", Wall(3.0, 0.0, np.radians(-23.5), np.radians(23.5))),
        ("seen at a slant", Wall(1.5, 0.0, np.radians(57.0), np.radians(73.0))),
    )
    figure, panels = _panels(2, f"Covariance of one fit, and the scatter of {TRIALS} fits", 4.1)
    for axes, (name, wall) in zip(panels, cases, strict=True):
        offsets = deviations(wall, seed)
        millimetres = 1e3 * offsets.found
        for fit in millimetres[:SHOWN_FITS]:
            axes.plot(offsets.along, fit, color=SKY, linewidth=0.6, alpha=0.6)
        axes.plot([], [], color=SKY, label=f"{SHOWN_FITS} of {TRIALS} fits")
        band = SIGMAS_95 * 1e3 * offsets.claimed
        axes.plot(offsets.along, band, color=INK, linewidth=1.6, label="95 % band of one fit's covariance")
        axes.plot(offsets.along, -band, color=INK, linewidth=1.6)
        low, high = np.percentile(millimetres, [2.5, 97.5], axis=0)
        dashes: dict[str, Any] = {"color": VERMILLION, "linestyle": (0, (3, 2)), "linewidth": 1.6}
        axes.plot(offsets.along, low, label="95 % of all fits", **dashes)
        axes.plot(offsets.along, high, **dashes)
        axes.axvspan(*wall.span, color=ORANGE, alpha=0.12, linewidth=0, label="observed part")
        text = f"{name}: {len(wall.bearings)} rays on a wall {wall.distance:g} m away"
        _label(axes, text, "along the wall, metres", "offset from the true wall, mm")
        axes.set_ylim(-1.6 * band.max(), 1.6 * band.max())
    _legend_below(figure, panels[0])
    save(figure, path)


def plot_parameters(path: Path, seed: int = 0) -> None:
    """Plot a short, distant wall in (u, v) and in (d, alpha): only (u, v) is Gaussian. Raises OutputError."""
    noise = Noise(sigma_range=0.05, sigma_bearing=float(np.radians(0.1)))
    wall = Wall(4.0, 0.0, np.radians(-2.5), np.radians(2.6))
    uv, polar = line_parameters(wall, noise, seed)
    title = f"Parameters of a wall of {np.ptp(wall.span):.2f} m at {wall.distance:g} m: Gaussian in (u, v) only"
    figure, (left, right) = _panels(2, title, 4.2)
    _draw_cloud(left, uv, scale=np.ones(2))
    _label(left, f"(u, v): {_share(uv)}", "u, 1/metres", "v, 1/metres")
    _draw_cloud(right, polar, scale=np.array([1.0, np.degrees(1.0)]))
    _label(right, f"distance and direction: {_share(polar)}", "distance d, metres", "direction α, degrees")
    _legend_below(figure, left)
    save(figure, path)


def plot_corners(path: Path, seed: int = 0) -> None:
    """Plot corners of two walls at three angles, with the 95 % ellipse of one scan. Raises OutputError."""
    figure, panels = _panels(3, "Corner of two walls, by their angle", 4.2)
    corner, bearing, half_view = np.array([3.0, 0.0]), 0.0, np.radians(14.0)
    for axes, angle in zip(panels, (90.0, 45.0, 20.0), strict=True):
        half_angle = np.radians(angle / 2)
        walls = (
            _through(corner, np.radians(90) - half_angle, bearing - half_view, bearing),
            _through(corner, np.radians(90) + half_angle, bearing, bearing + half_view),
        )
        cloud = corner_positions(*walls, seed=seed)
        millimetres = np.array([1e3, 1e3])
        centred = Cloud(cloud.found - cloud.truth, np.zeros(2), cloud.covariance, cloud.within)
        _draw_cloud(axes, centred, scale=millimetres)
        axes.set_aspect("equal", adjustable="datalim")
        _label(axes, f"{angle:.0f}°: {_share(cloud)}", "error in range, mm", "error across, mm")
    _legend_below(figure, panels[0])
    save(figure, path)


def _share(cloud: Cloud) -> str:
    return f"{100 * cloud.within:.0f} % within their own ellipses"


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=len(labels), **LEGEND)


def _through(point: Floats, direction: float, low: float, high: float) -> Wall:
    """Return the wall through a point, in a direction (radians), observed between two bearings."""
    normal = direction - np.pi / 2
    distance = float(point @ np.array([np.cos(normal), np.sin(normal)]))
    return Wall(distance, normal, low, high) if distance > 0 else Wall(-distance, normal + np.pi, low, high)


def _draw_cloud(axes: Axes, cloud: Cloud, scale: Floats) -> None:
    """Draw all estimates, the truth, and one estimate's 95 % ellipse around it; axes in units of 1 / `scale`."""
    axes.plot(*(scale * cloud.found).T, color=BLUE, **DOT)
    axes.plot([], [], ".", color=BLUE, label=f"{len(cloud.found)} estimates")
    variances, directions = np.linalg.eigh(cloud.covariance)
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = RADIUS_95 * np.stack([np.cos(turn), np.sin(turn)])
    outline = cloud.truth + (directions @ (np.sqrt(variances)[:, None] * circle)).T
    axes.plot(
        *(scale * outline).T, color=INK, linewidth=1.6, label="95 % ellipse of one estimate, centred at the truth"
    )
    axes.plot(*(scale * cloud.truth), "+", color=VERMILLION, markersize=10, markeredgewidth=2, label="truth")
    axes.margins(0.08)
