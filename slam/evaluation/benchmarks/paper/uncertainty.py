"""Measure the standard deviations of corners by three methods, and their true errors (Tables I and II)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from drivers.immutable import immutable
from features import ESTIMATORS

from ....geometry.segments import Floats
from ..monte_carlo import CHI2_95
from . import formulas
from .environments import PAPER_NOISE, Environment
from .formulas import Corner, Fit

METHODS = ("wclm", "arras-siegwart", "siadat")
"""In the order of the paper's tables."""
OURS = (*METHODS, "wclm-ml")
EQUAL_WEIGHTS = "arras-siegwart, equal weights"
ESTIMATOR_FUNCTIONS: dict[str, tuple[Callable[..., Any], Callable[..., tuple[Floats, Floats]]]] = {
    **{name: (ESTIMATORS[name].fit, ESTIMATORS[name].corner) for name in OURS},
    EQUAL_WEIGHTS: (partial(formulas.arras_siegwart, power=0), formulas.arras_siegwart_corner),
}
"""Functions of each method to fit a line and to intersect two."""
MILLIMETRES = 1e3
UNCERTAINTY_SWEEPS = 200
"""Number of sweeps with independent noise."""
CLEAR = 60.0
"""Millimetres, both axes together. Only corners below it clearly show the excess of the paper's Siadat columns."""


@immutable
class Uncertainties:
    """Uncertainties of one environment's m corners by method.

    claimed   (m, 2) standard deviations in x and y from one sweep, millimetres
    nees      (SWEEPS, m) normalised estimation errors squared
    errors    (m, 2) half of the central 68 % interval of the errors, millimetres
    """

    claimed: dict[str, Floats]
    nees: dict[str, Floats]
    errors: dict[str, Floats]


def measure(environment: Environment, seed: int, sweeps: int = UNCERTAINTY_SWEEPS) -> Uncertainties:
    """Estimate all corners from `sweeps` independent sweeps; the tables show the first.

    Errors are relative to the same method's result without noise, because chords of curves differ by method.
    """
    random = np.random.default_rng(seed)
    noisy_ranges = [environment.measure(random) for _ in range(sweeps)]
    claimed, nees, errors = {}, {}, {}
    for name, (fit, meet) in ESTIMATOR_FUNCTIONS.items():
        truth = corners(environment, environment.ranges, fit, meet)[0]
        found = [corners(environment, ranges, fit, meet) for ranges in noisy_ranges]
        error = np.stack([positions for positions, _ in found]) - truth
        covariance = np.stack([spread for _, spread in found])
        claimed[name] = MILLIMETRES * np.sqrt(np.diagonal(covariance[0], axis1=1, axis2=2))
        nees[name] = np.einsum("smi,smi->sm", error, np.linalg.solve(covariance, error[..., None])[..., 0])
        low, high = np.quantile(error, (0.16, 0.84), axis=0)
        errors[name] = MILLIMETRES * (high - low) / 2
    return Uncertainties(claimed, nees, errors)


def corners(
    environment: Environment,
    ranges: Floats,
    fit: Callable[..., Any],
    meet: Callable[..., tuple[Floats, Floats]],
) -> tuple[Floats, Floats]:
    """Return positions (m, 2) and covariances (m, 2, 2) of all corners, from all rays of their segments."""
    fits = [fit(ranges[s.rays], environment.angles[s.rays], PAPER_NOISE) for s in environment.segments]
    found = [meet(fits[before], fits[after]) for before, after in environment.corners]
    return np.stack([position for position, _ in found]), np.stack([covariance for _, covariance in found])


def table(environment: Environment, uncertainties: Uncertainties, printed: Floats) -> list[dict[str, Any]]:
    """Return a row per corner: the paper's and our standard deviations and the true errors, (x, y) in millimetres."""
    return [
        {
            "corner": number + 1,
            "rays": [len(environment.segments[s].rays) for s in environment.corners[number]],
            "paper": {name: row[1 + 2 * k : 3 + 2 * k].tolist() for k, name in enumerate(METHODS)},
            "ours": {name: uncertainties.claimed[name][number].tolist() for name in OURS},
            "true": {name: uncertainties.errors[name][number].tolist() for name in OURS},
        }
        for number, row in enumerate(printed)
    ]


def consistency(uncertainties: Uncertainties) -> dict[str, dict[str, float]]:
    """Return by method the median NEES (expected 1.386) and the share of errors within the 95 % ellipse."""
    return {
        name: {"median_nees": float(np.median(nees)), "within_95": float(np.mean(nees <= CHI2_95))}
        for name, nees in uncertainties.nees.items()
    }


def ratios(numerator: Floats, denominator: Floats) -> dict[str, float]:
    """Return quantiles of the ratio of two sets of standard deviations."""
    low, middle, high = np.quantile(numerator / denominator, (0.1, 0.5, 0.9))
    return {"10 %": float(low), "median": float(middle), "90 %": float(high)}


def siadat_variants(environment: Environment, seed: int) -> dict[str, dict[str, float]]:
    """Return the ratios of Siadat's to Arras-Siegwart's standard deviations for variants of Siadat's method."""
    ranges = environment.measure(np.random.default_rng(seed))
    reference = _standard_deviations(environment, ranges, formulas.arras_siegwart, formulas.arras_siegwart_corner)
    variants: dict[str, Fit] = {
        "the same weights": formulas.siadat,
        "equal weights for Siadat only": partial(formulas.siadat, power=0),
        "correlations of (a, b, c) left out": lambda r, a, n: formulas.without_correlations(formulas.siadat(r, a, n)),
    }
    found = {
        name: _standard_deviations(environment, ranges, fit, formulas.siadat_corner) for name, fit in variants.items()
    }
    found["one reading's range noise added"] = np.sqrt(reference**2 + _single_range_variance(environment))
    return {name: ratios(spread, reference) for name, spread in found.items()}


def siadat_excess(printed: Floats) -> dict[str, float]:
    """Return the excess of the paper's Siadat columns over its Arras-Siegwart columns, in quadrature, mm."""
    spread = printed[:, 1:].reshape(-1, len(METHODS), 2)
    total = np.sum(spread**2, axis=2)
    clear = np.sqrt(total[:, 1]) < CLEAR
    excess = np.sqrt(total[clear, 2] - total[clear, 1])
    return {
        "corners": int(clear.sum()),
        "least": float(excess.min()),
        "median": float(np.median(excess)),
        "largest": float(excess.max()),
    }


def difference_of_equals(environment: Environment, seed: int) -> float:
    """Return the largest relative difference of Siadat's and Arras-Siegwart's corner covariances with equal weighting.

    Both the weights of eq. (17) and uniform ones are compared.
    """
    ranges = environment.measure(np.random.default_rng(seed))
    worst = 0.0
    for power in (0, 2):
        arras_siegwart = partial(formulas.arras_siegwart, power=power)
        siadat = partial(formulas.siadat, power=power)
        one = corners(environment, ranges, arras_siegwart, formulas.arras_siegwart_corner)[1]
        other = corners(environment, ranges, siadat, formulas.siadat_corner)[1]
        worst = max(worst, float((np.abs(one - other).max(axis=(1, 2)) / np.abs(one).max(axis=(1, 2))).max()))
    return worst


def _standard_deviations(environment: Environment, ranges: Floats, fit: Fit, meet: Corner) -> Floats:
    return np.sqrt(np.diagonal(corners(environment, ranges, fit, meet)[1], axis1=1, axis2=2))


def _single_range_variance(environment: Environment) -> Floats:
    """Return the variances (m, 2) in x and y of a single range at the corners' bearings."""
    directions = environment.positions / np.linalg.norm(environment.positions, axis=1)[:, None]
    return np.asarray((PAPER_NOISE.sigma_range * directions) ** 2)
