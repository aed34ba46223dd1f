"""Format the measurements of the paper benchmark as text tables."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ....geometry.segments import Floats
from .claims import Claim
from .run import PRINTED, TIMED
from .timing import FORMS
from .uncertainty import EQUAL_WEIGHTS, METHODS, OURS

TABLE_WIDTH = 120
SHORT = {"wclm": "WCLM", "arras-siegwart": "Arras-Siegw.", "siadat": "Siadat", "wclm-ml": "WCLM-ML"}
LONG = {**SHORT, "arras-siegwart": "Arras-Siegwart", EQUAL_WEIGHTS: "Arras-Siegwart, equal weights"}


def lines(measured: dict[str, Any], times: dict[str, Any] | None, claims: Sequence[Claim]) -> Iterator[str]:
    """Yield the lines of all tables."""
    yield from heading("Claims")
    for claim in claims:
        yield from textwrap.wrap(f"{claim.verdict.upper()}: {claim.says}", TABLE_WIDTH)
        yield from textwrap.wrap(
            claim.why, TABLE_WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
        )
    for number, name in (("I", "A"), ("II", "B")):
        yield from uncertainty_table(number, name, measured["environments"][name])
    if times is not None:
        yield from times_table("III", "A20", "corner 20 of environment A", times["A20"])
        yield from times_table("IV", "B4", "corner 4 of environment B", times["B4"])
    yield from figure_5_table(measured["figure_5"])
    yield from tracking_table(measured["tracking"])


def heading(text: str) -> Iterator[str]:
    """Yield a title and a rule below it."""
    yield from ("", text, "-" * len(text))


def uncertainty_table(number: str, name: str, world: dict[str, Any]) -> Iterator[str]:
    """Yield Table I or II: standard deviations per corner by the paper and here, and true errors."""
    yield from heading(f"Table {number}: corners of environment {name}, standard deviations in x / y, mm")
    width, depth = world["size"]
    yield (
        f"{width:.0f} x {depth:.0f} m, {world['points']} points, {world['segments']} segments, "
        f"{len(PRINTED[name])} corners; the floor plan is reconstructed: compare sizes and ratios, not single corners"
    )
    yield "                 | the paper's                                 | ours, from one sweep"
    yield (
        "corner     rays  | "
        + " ".join(f"{SHORT[m]:>14}" for m in METHODS)
        + " | "
        + " ".join(f"{SHORT[m]:>14}" for m in OURS)
        + " | true, WCLM-ML"
    )
    for row in world["table"]:
        paper = " ".join(_pair(row["paper"][method]) for method in METHODS)
        ours = " ".join(_pair(row["ours"][method]) for method in OURS)
        rays = "{} + {}".format(*row["rays"])
        yield f"{row['corner']:6d} {rays:>9} | {paper} | {ours} |{_pair(row['true']['wclm-ml'])}"
    yield "ratio to Arras-Siegwart, quantiles of 10, 50, 90 %:"
    for who, ratio in world["wclm over arras-siegwart"].items():
        yield f"  {'WCLM, ' + who:<42} {_quantiles(ratio)}"
    for who, ratio in world["siadat over arras-siegwart"].items():
        yield f"  {'Siadat, ' + who:<42} {_quantiles(ratio)}"
    yield "NEES (expected median 1.39), errors within the 95 % ellipse:"
    for method, figures in world["consistency"].items():
        yield f"  {LONG[method]:<30} {figures['median_nees']:6.2f} {100 * figures['within_95']:6.1f} %"


def times_table(number: str, key: str, where: str, rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield Table III or IV: microseconds by number of points."""
    yield from heading(f"Table {number}: microseconds for {where}, by number of points (two lines, half of them each)")
    yield "the paper's: MATLAB on an i9-9900K, cost per point; NumPy: cost per call, nearly independent of the points;"
    yield "compiled: without sines and cosines; 'AS double' with single sums in the Jacobians"
    short = ("WCLM", "AS double", "AS single", "Siadat")
    yield "       | the paper's (MATLAB)        | NumPy" + " " * 41 + "| compiled"
    names = " ".join(f"{name:>9}" for name in short)
    yield f"points | {'WCLM':>9} {'AS':>9} {'Siadat':>7} | {names}  AS/W  | {names}  AS/W"
    for printed, row in zip(TIMED[key], rows, strict=True):
        sides = []
        for language, digits in (("numpy", 1), ("compiled", 2)):
            values = [row[language][form] for form in FORMS]
            sides.append(" ".join(f"{v:9.{digits}f}" for v in values) + f" {values[1] / values[0]:5.1f}")
        yield f"{row['points']:6d} | {printed[1]:9.2f} {printed[2]:9.2f} {printed[3]:7.2f} | {sides[0]}  | {sides[1]}"


def figure_5_table(curves: dict[str, Any]) -> Iterator[str]:
    """Yield some values of Figure 5's left axes."""
    yield from heading("Figure 5: standard deviations of corners in x / y, mm, by number of points")
    yield "corner points   " + " ".join(f"{SHORT[method]:>14}" for method in OURS)
    for name, curve in curves.items():
        for k in (0, 1, 3, 6, len(curve["points"]) - 1):
            values = " ".join(_pair(curve["sigma"][method][k]) for method in OURS)
            yield f"{name:>6} {curve['points'][k]:6d}   {values}"


def tracking_table(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield walls and corners found by the paper's tracking and by this project's segmentation, by noise."""
    yield from heading("Tracking with 20 mm and this project's segmentation: walls and corners found, %")
    yield "range noise mm  bearing noise deg |  tracking: walls  corners |  splitting: walls  corners"
    for row in rows:
        found = [100 * row[method][what] for method in ("tracking", "split") for what in ("walls", "corners")]
        yield (
            f"{1e3 * row['sigma_range']:14.0f} {np.degrees(row['sigma_bearing']):18.4f} | "
            f"{found[0]:16.1f} {found[1]:8.1f} | {found[2]:17.1f} {found[3]:8.1f}"
        )


def _pair(values: Sequence[float] | Floats) -> str:
    return f"{values[0]:6.1f} /{values[1]:6.1f}"


def _quantiles(ratio: dict[str, float]) -> str:
    return " ".join(f"{value:6.2f}" for value in ratio.values())
