"""Measure time and uncertainty of one corner by the number of its points (Tables III and IV, Figure 5).

The time is that of the whole computation from ranges to a corner with its covariance: two lines, with half of the
points each. It is measured for plain NumPy, comparable to the paper's MATLAB, and for compiled loops.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import njit

from features import ESTIMATORS, Noise
from features.arras_siegwart import (
    direction_by_double_sums,
    direction_by_single_sums,
    polar_covariance,
    polar_line,
)
from features.corner import intersect
from features.estimators import SIADAT, WCLM, fit_by_code
from features.line_fit import ray_arrays

from ....geometry.segments import Floats
from . import formulas
from .environments import PAPER_NOISE, Environment
from .formulas import Corner, Fit

FORMS = ("wclm", "arras-siegwart, double sums", "arras-siegwart, single sums", "siadat")
TIMING_ROUNDS = 30
"""Number of alternating rounds, of which the minimum counts: other load on the machine only makes times longer."""
MIN_ROUND_TIME = 3e-4
"""Seconds; shorter calls are repeated within a round."""
MICROSECONDS = 1e6

Call = Callable[[], object]
CornerFive = tuple[float, float, float, float, float]


def half_each(environment: Environment, corner: int, points: int) -> list[tuple[Floats, Floats]]:
    """Return noise-free (ranges, angles) of each wall's points/2 rays nearest to the corner."""
    walls = [rays[: points // 2] for rays in environment.rays_of_corner(corner)]
    return [(environment.ranges[rays], environment.angles[rays]) for rays in walls]


def point_counts(environment: Environment, corner: int, at_most: int) -> list[int]:
    """Return the tested numbers of points, 10, 20, ..., limited by the corner's shorter wall."""
    shorter = min(len(rays) for rays in environment.rays_of_corner(corner))
    return list(range(10, min(2 * shorter, at_most) + 1, 10))


def numpy_calls(walls: Sequence[tuple[Floats, Floats]]) -> dict[str, Call]:
    """Return a function per form that computes the corner from ranges in plain NumPy."""

    def corner_call(fit: Fit, corner: Corner) -> Call:
        return lambda: corner(fit(*walls[0], PAPER_NOISE), fit(*walls[1], PAPER_NOISE))

    def double(ranges: Floats, angles: Floats, noise: Noise) -> formulas.Line:
        return formulas.arras_siegwart(ranges, angles, noise, sums="double")

    calls = (
        corner_call(formulas.wclm, formulas.wclm_corner),
        corner_call(double, formulas.arras_siegwart_corner),
        corner_call(formulas.arras_siegwart, formulas.arras_siegwart_corner),
        corner_call(formulas.siadat, formulas.siadat_corner),
    )
    return dict(zip(FORMS, calls, strict=True))


def compiled_calls(walls: Sequence[tuple[Floats, Floats]]) -> dict[str, Call]:
    """Return the same functions compiled, starting from inverse ranges, sines and cosines, which all forms need.

    The double sums also start from these and omit the double sums of the Jacobians: a lower bound of their cost.
    """
    first, second = (np.stack(ray_arrays(*wall)) for wall in walls)
    sigmas = PAPER_NOISE.sigma_range, PAPER_NOISE.sigma_bearing
    calls: tuple[Call, ...] = (
        lambda: _by_code(WCLM, first, second, *sigmas),
        lambda: _polar(True, first, second, *sigmas),
        lambda: _polar(False, first, second, *sigmas),
        lambda: _by_code(SIADAT, first, second, *sigmas),
    )
    return dict(zip(FORMS, calls, strict=True))


def times(
    environment: Environment, corner: int, points: Sequence[int], rounds: int = TIMING_ROUNDS
) -> list[dict[str, Any]]:
    """Return the microseconds by form, in plain NumPy and compiled, for each number of points."""
    calls: dict[tuple[int, str, str], Call] = {}
    for count in points:
        walls = half_each(environment, corner, count)
        for language, forms in (("numpy", numpy_calls(walls)), ("compiled", compiled_calls(walls))):
            calls |= {(count, language, form): call for form, call in forms.items()}
    microseconds_by_call = fastest(list(calls.values()), rounds)
    rows: dict[int, dict[str, Any]] = {count: {"points": count, "numpy": {}, "compiled": {}} for count in points}
    for (count, language, form), microseconds in zip(calls, microseconds_by_call, strict=True):
        rows[count][language][form] = microseconds
    return list(rows.values())


def fastest(calls: Sequence[Call], rounds: int) -> list[float]:
    """Return the microseconds of each call: the smallest mean of `rounds` rounds, each of which times all calls."""
    repeats = []
    for call in calls:
        call()  # compiles or loads its functions
        start = time.perf_counter()
        call()
        repeats.append(max(1, math.ceil(MIN_ROUND_TIME / max(time.perf_counter() - start, 1e-7))))
    fastest_times = [math.inf] * len(calls)
    for _ in range(rounds):
        for k, (call, count) in enumerate(zip(calls, repeats, strict=True)):
            start = time.perf_counter()
            for _ in range(count):
                call()
            fastest_times[k] = min(fastest_times[k], (time.perf_counter() - start) / count)
    return [MICROSECONDS * seconds for seconds in fastest_times]


def uncertainty_by_points(environment: Environment, corner: int, points: Sequence[int]) -> dict[str, list[list[float]]]:
    """Return by method the corner's standard deviations in x and y, millimetres, for each number of points.

    They are propagated at the true ranges, so that the curves do not depend on one noise sample.
    """
    maximum_likelihood = ESTIMATORS["wclm-ml"]
    methods: dict[str, tuple[Callable[..., Any], Callable[..., tuple[Floats, Floats]]]] = {
        "wclm": (formulas.wclm, formulas.wclm_corner),
        "arras-siegwart": (formulas.arras_siegwart, formulas.arras_siegwart_corner),
        "siadat": (formulas.siadat, formulas.siadat_corner),
        "wclm-ml": (maximum_likelihood.fit, maximum_likelihood.corner),
    }
    found: dict[str, list[list[float]]] = {name: [] for name in methods}
    for count in points:
        walls = half_each(environment, corner, count)
        for name, (fit, meet) in methods.items():
            covariance = meet(fit(*walls[0], PAPER_NOISE), fit(*walls[1], PAPER_NOISE))[1]
            found[name].append((1e3 * np.sqrt(np.diag(covariance))).tolist())
    return found


def growth(points: Floats, microseconds: Floats, since: int = 60) -> float:
    """Return the exponent k of time ~ points^k from `since` points on, where fixed costs matter less."""
    late = points >= since
    return float(np.polyfit(np.log(points[late]), np.log(microseconds[late]), 1)[0])


# Not cached on disk: the cache would not notice changes of the called functions of another package.
_compiled = njit(error_model="numpy")


@_compiled
def _by_code(code: int, one: Floats, two: Floats, sr: float, sb: float) -> CornerFive:
    """Fit two lines by one of this project's estimators, and intersect them by eqs. (36)-(38)."""
    covariances = np.empty((2, 2, 2))
    u1, v1, cuu1, cuv1, cvv1 = fit_by_code(code, one[0], one[1], one[2], sr, sb)
    u2, v2, cuu2, cuv2, cvv2 = fit_by_code(code, two[0], two[1], two[2], sr, sb)
    covariances[0, 0, 0], covariances[0, 0, 1], covariances[0, 1, 1] = cuu1, cuv1, cvv1
    covariances[1, 0, 0], covariances[1, 0, 1], covariances[1, 1, 1] = cuu2, cuv2, cvv2
    return intersect(u1, v1, covariances[0], u2, v2, covariances[1])


@_compiled
def _polar(double: bool, one: Floats, two: Floats, sr: float, sb: float) -> CornerFive:
    """Fit two lines by eqs. (26)-(30), and intersect them by eqs. (39)-(43)."""
    if double:
        n1, d1 = direction_by_double_sums(one[0], one[1], one[2])
        n2, d2 = direction_by_double_sums(two[0], two[1], two[2])
    else:
        n1, d1 = direction_by_single_sums(one[0], one[1], one[2])
        n2, d2 = direction_by_single_sums(two[0], two[1], two[2])
    line1, line2 = polar_line(one[0], one[1], one[2], n1, d1), polar_line(two[0], two[1], two[2], n2, d2)
    vr1, vra1, va1 = polar_covariance(one[0], one[1], one[2], n1, d1, line1, sr, sb)
    vr2, vra2, va2 = polar_covariance(two[0], two[1], two[2], n2, d2, line2, sr, sb)
    (r1, a1), (r2, a2) = line1[:2], line2[:2]
    ca1, sa1, ca2, sa2 = math.cos(a1), math.sin(a1), math.cos(a2), math.sin(a2)
    sine = sa2 * ca1 - ca2 * sa1
    x, y = (r1 * sa2 - r2 * sa1) / sine, (r2 * ca1 - r1 * ca2) / sine
    t1, t2 = y * ca1 - x * sa1, y * ca2 - x * sa2
    q1 = (vr1 - 2.0 * t1 * vra1 + t1 * t1 * va1) / (sine * sine)
    q2 = (vr2 - 2.0 * t2 * vra2 + t2 * t2 * va2) / (sine * sine)
    return x, y, q1 * sa2 * sa2 + q2 * sa1 * sa1, -q1 * sa2 * ca2 - q2 * sa1 * ca1, q1 * ca2 * ca2 + q2 * ca1 * ca1
