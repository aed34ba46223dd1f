"""Judge the paper's claims by fixed rules on the measured figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....geometry.segments import Floats
from .environments import PAPER_NOISE
from .numbers import STATED_MEANS, STATED_RATIO, TABLE_1, TABLE_2, TABLE_3, TABLE_4
from .timing import FORMS, growth
from .tracking import BEARINGS, largest_usable
from .uncertainty import EQUAL_WEIGHTS

HOLDS, IN_PART, FAILS = "holds", "holds in part", "does not hold"
WCLM, DOUBLE, SINGLE, SIADAT = FORMS
EQUAL = 1e-9
"""Relative difference up to which two results are equal except for rounding."""
SIMILAR = 0.1
"""Deviation from 1 of the median ratio of two methods' standard deviations, up to which they are similar."""
FASTER = 1.3
"""Ratio of times from which one method is faster; machine load and compilers cause smaller ratios."""
LINEAR, QUADRATIC = 1.2, 1.5
"""Exponents of time in the number of points: at most linear up to the first, quadratic from the second."""
MAX_ROUNDING = 2.0
"""Millimetres between a mean and its stated value, which is rounded to 0.1 cm and covers two methods."""
CONVERGED_RATIO = 0.9
"""Ratio of the standard deviations with all points and with half of them, above which they have converged."""


class Claim(NamedTuple):
    """A statement of the paper, the verdict, and the explanation."""

    says: str
    verdict: str
    why: str


def judge(measured: dict[str, Any], times: dict[str, Any] | None) -> list[Claim]:
    """Return all claims; those about times only if times were measured."""
    judged = [_similar(measured), _siadat(measured), _means(), _convergence(measured), _threshold(measured)]
    return judged if times is None else judged + _times(times)


def _similar(measured: dict[str, Any]) -> Claim:
    ours = [world["wclm over arras-siegwart"]["ours"]["median"] for world in measured["environments"].values()]
    alike = all(abs(ratio - 1.0) <= SIMILAR for ratio in ours)
    inside = {
        name: [f"{100 * world['consistency'][name]['within_95']:.0f}" for world in measured["environments"].values()]
        for name in ("wclm", "arras-siegwart", EQUAL_WEIGHTS)
    }
    return Claim(
        "WCLM and Arras-Siegwart give similar uncertainties of corners.",
        HOLDS if alike else FAILS,
        f"The median ratio is {ours[0]:.2f} in A and {ours[1]:.2f} in B. But of the true errors, "
        f"{' and '.join(inside['wclm'])} % are within WCLM's 95 % ellipse, "
        f"{' and '.join(inside['arras-siegwart'])} % within that of Arras-Siegwart "
        f"({' and '.join(inside[EQUAL_WEIGHTS])} % with equal weights). It minimises distances perpendicular to "
        "the line, although the noise is along the ray, and takes the scatter of short, slanted walls for direction.",
    )


def _siadat(measured: dict[str, Any]) -> Claim:
    worlds = measured["environments"].values()
    difference = max(world["siadat with the same weights differs by"] for world in worlds)
    excess = [world["siadat's excess in the paper"] for world in worlds]
    clear = " and ".join(
        f"{e['median']:.0f} mm in {name} (median of {e['corners']} clear corners, "
        f"{e['least']:.0f} to {e['largest']:.0f})"
        for name, e in zip(measured["environments"], excess, strict=True)
    )
    return Claim(
        "Siadat is systematically less accurate.",
        FAILS if difference <= EQUAL else HOLDS,
        "With the same weights, estimate and covariance equal those of Arras-Siegwart (largest relative difference "
        f"{difference:.0e}). The paper's columns have an excess, in quadrature, of {clear}: about the range noise of a "
        f"single reading, {1e3 * PAPER_NOISE.sigma_range:.0f} mm. No part of the method adds it.",
    )


def _means() -> Claim:
    of_a = TABLE_1[:, 1:].mean(axis=0)
    of_both = np.concatenate([TABLE_1, TABLE_2])[:, 1:].mean(axis=0)
    stated = np.array([STATED_MEANS[axis][k] for k in (0, 0, 1) for axis in ("x", "y")])
    right = [np.abs(found - stated).max() < MAX_ROUNDING for found in (of_a, of_both)]
    return Claim(
        "Corners are uncertain by 5.6 and 6.5 cm in x and y on average with WCLM and Arras-Siegwart, by 6.8 and 8.5 cm "
        "with Siadat.",
        HOLDS if all(right) else IN_PART if any(right) else FAILS,
        f"Its Table I has {_millimetres(of_a[:4])} mm and {_millimetres(of_a[4:])} mm, so the statement is about "
        f"environment A. With Table II the means are {_millimetres(of_both[:4])} and {_millimetres(of_both[4:])} mm.",
    )


def _convergence(measured: dict[str, Any]) -> Claim:
    ratios = {name: _ratios_to_half(measured["figure_5"], name) for name in ("wclm", "wclm-ml")}
    converged = ratios["wclm"] >= CONVERGED_RATIO
    return Claim(
        "Uncertainties converge to a certain value as points are added.",
        HOLDS if converged.all() else IN_PART if converged.any() else FAILS,
        f"From half of the points to all, the eight standard deviations of four corners change by factors of "
        f"{_factors(ratios['wclm'])}; 0.71 is 1 / sqrt(2). Where they remain constant, rays that hit a wall head-on "
        f"have more noise across it than those near the corner, which weights by range ignore. With each ray's own "
        f"variance (WCLM-ML): {_factors(ratios['wclm-ml'])}.",
    )


def _ratios_to_half(curves: dict[str, Any], method: str) -> Floats:
    """Return the ratios (2 * corners,) of the standard deviations in x and y with all points to those with half."""
    found = []
    for curve in curves.values():
        points, sigma = np.array(curve["points"]), np.array(curve["sigma"][method])
        found.append(sigma[-1] / sigma[np.abs(points - points[-1] / 2).argmin()])
    return np.concatenate(found)


def _threshold(measured: dict[str, Any]) -> Claim:
    rows = measured["tracking"]
    usable = [1e3 * largest_usable(rows, bearing) for bearing in BEARINGS]
    at_paper = next(
        row["tracking"]["walls"]
        for row in rows
        if row["sigma_range"] == PAPER_NOISE.sigma_range and row["sigma_bearing"] == PAPER_NOISE.sigma_bearing
    )
    with_paper_noise = "at no tested level" if usable[1] == 0.0 else f"up to {usable[1]:.0f} mm"
    return Claim(
        "Lines are tracked with a threshold of 20 mm, in scans with a noise of 5 cm in range and 0.1955° in bearing.",
        FAILS if at_paper < 0.5 else HOLDS,
        f"Not both. With that noise, tracking finds {100 * at_paper:.1f} % of the walls. It finds 90 % up to "
        f"{usable[0]:.0f} mm of range noise without bearing noise, and {with_paper_noise} with the paper's. So the "
        "noise of the paper's scans was millimetres, or they were tracked differently. In the former case, all "
        "printed uncertainties are too large: 5 cm is the data sheet's accuracy, not the white noise of each ray.",
    )


def _times(times: dict[str, Any]) -> list[Claim]:
    at_100 = {name: _row(rows, 100) for name, rows in times.items() if name in ("A20", "B4")}
    last = times["B4"][-1]
    printed = [TABLE_3[-1, 2] / TABLE_3[-1, 1], TABLE_4[-1, 2] / TABLE_4[-1, 1]]
    double, single, siadat = (
        {language: last[language][form] / last[language][WCLM] for language in ("numpy", "compiled")}
        for form in (DOUBLE, SINGLE, SIADAT)
    )
    double_at_100 = {name: row["numpy"][DOUBLE] / row["numpy"][WCLM] for name, row in at_100.items()}
    exponents = _exponents(times["B4"])
    points = last["points"]
    ours = f"WCLM, double sums, single sums, Siadat {', '.join(f'{e:.1f}' for e in exponents)}"
    paper = ", ".join(f"{growth(TABLE_4[:, 0], TABLE_4[:, k]):.1f}" for k in (1, 2, 3))
    return [
        Claim(
            "WCLM takes less time than Arras-Siegwart.",
            IN_PART if min(single.values()) < FASTER <= min(double.values()) else _when(min(single.values()) >= FASTER),
            f"Compared with the double sums it does, {double['numpy']:.1f} times in NumPy and "
            f"{double['compiled']:.0f} times compiled at {points} points. But those are products of single sums. "
            f"Factorised, the same numbers take {single['numpy']:.2f} times WCLM's time in NumPy and "
            f"{single['compiled']:.2f} times compiled.",
        ),
        Claim(
            "Arras-Siegwart takes up to 10 to 15 times as long.",
            IN_PART if max(printed) > STATED_RATIO[1] else HOLDS,
            f"The paper's own tables reach {printed[0]:.1f} at 130 points and {printed[1]:.1f} at 230. There is no "
            "limit: the ratio grows with the number of points, quadratic over linear. Here it is "
            f"{double_at_100['A20']:.1f} at 100 points and {double['numpy']:.1f} at {points} in NumPy.",
        ),
        Claim(
            "WCLM takes less time than Siadat.",
            HOLDS if min(siadat.values()) >= FASTER else IN_PART if max(siadat.values()) >= FASTER else FAILS,
            f"By factors of {siadat['numpy']:.2f} in NumPy and {siadat['compiled']:.2f} compiled at {points} points; "
            f"{TABLE_4[-1, 3] / TABLE_4[-1, 1]:.1f} in the paper.",
        ),
        Claim(
            "WCLM's time grows slowly with the number of points.",
            _when(exponents[0] <= LINEAR and exponents[1] >= QUADRATIC),
            f"Compiled, time grows as points to the power of: {ours}; with few points, most of the time is the call. "
            f"In the paper's Table IV: WCLM, Arras-Siegwart, Siadat {paper}.",
        ),
    ]


def _exponents(rows: Sequence[dict[str, Any]]) -> list[float]:
    points = np.array([row["points"] for row in rows], dtype=np.float64)
    return [growth(points, np.array([row["compiled"][form] for row in rows])) for form in FORMS]


def _row(rows: Sequence[dict[str, Any]], points: int) -> dict[str, Any]:
    return next(row for row in rows if row["points"] >= min(points, rows[-1]["points"]))


def _when(true: bool) -> str:
    return HOLDS if true else FAILS


def _factors(values: Floats) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _millimetres(values: Floats) -> str:
    return ", ".join(f"{value:.1f}" for value in values)
