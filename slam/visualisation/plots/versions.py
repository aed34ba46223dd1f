"""A picture of drives over versions: accuracy, time, memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .style import BLUE, DOTS_PER_INCH, GREEN, INK, MUTED, ORANGE, SKY, VERMILLION, calm, headline, save

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, SKY, MUTED)
MARKERS = "os^D"
"""By turns, where there are more drives than colours."""
PANELS = (
    ("error", "Error", "metres: relations, or the true path"),
    ("by_reference", "Time", "of a scan, in units of the reference"),
    ("memory", "Memory", "MiB at most"),
)


def plot_versions(path: Path, versions: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Draw the drives of versions, in their order; drives that a version has not are left out. Raises OutputError."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.2), dpi=DOTS_PER_INCH, layout="constrained")
    names = list(dict.fromkeys(drive["name"] for drives in versions.values() for drive in drives))
    for axes, (key, title, unit) in zip(figure.subplots(1, 3), PANELS, strict=True):
        headline(axes, title, unit)
        for k, name in enumerate(names):
            known = [
                (place, drive[key])
                for place, drives in enumerate(versions.values())
                for drive in drives
                if drive["name"] == name
            ]
            marker, colour = MARKERS[k // len(COLOURS) % len(MARKERS)], COLOURS[k % len(COLOURS)]
            axes.plot(*zip(*known, strict=True), f"{marker}-", color=colour, markersize=5, label=name)
        if key == "error":  # of recordings and of simulations, which are an order of magnitude apart
            axes.set_yscale("log")
        else:
            axes.set_ylim(bottom=0.0)
        axes.set_xticks(range(len(versions)), list(versions))
        axes.set_xlim(-0.5, len(versions) - 0.5)
        calm(axes)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower left", ncols=len(labels), frameon=False, fontsize=8.5, labelcolor=INK
    )
    save(figure, path)
