"""Plot accuracy, time and memory of the benchmark runs over released versions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .style import BLUE, DOTS_PER_INCH, GREEN, INK, MUTED, ORANGE, SKY, VERMILLION, add_titles, save, style_axes

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, SKY, MUTED)
MARKERS = "os^D"
"""Cycled if there are more runs than colours."""
PANELS = (
    ("error", "Error", "metres, by relations or ground truth"),
    ("by_reference", "Time", "per scan, relative to the reference"),
    ("memory", "Memory", "peak, MiB"),
)


def plot_versions(path: Path, versions: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Plot the runs of each version, in the order of the versions; a version may lack runs. Raises OutputError."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.2), dpi=DOTS_PER_INCH, layout="constrained")
    names = list(dict.fromkeys(run["name"] for runs in versions.values() for run in runs))
    for axes, (key, title, unit) in zip(figure.subplots(1, 3), PANELS, strict=True):
        add_titles(axes, title, unit)
        for k, name in enumerate(names):
            points = [
                (index, run[key]) for index, runs in enumerate(versions.values()) for run in runs if run["name"] == name
            ]
            marker, colour = MARKERS[k // len(COLOURS) % len(MARKERS)], COLOURS[k % len(COLOURS)]
            axes.plot(*zip(*points, strict=True), f"{marker}-", color=colour, markersize=5, label=name)
        if key == "error":  # recordings and simulations are an order of magnitude apart
            axes.set_yscale("log")
        else:
            axes.set_ylim(bottom=0.0)
        axes.set_xticks(range(len(versions)), list(versions))
        axes.set_xlim(-0.5, len(versions) - 0.5)
        style_axes(axes)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower left", ncols=len(labels), frameon=False, fontsize=8.5, labelcolor=INK
    )
    save(figure, path)
