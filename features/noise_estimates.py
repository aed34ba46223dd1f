"""Estimate the variances of range and bearing from the residuals of the lines of one scan."""

from __future__ import annotations

from .compiled import inlined, vectorised
from .rays import RaySlice
from .settings import Settings
from .types import Floats
from .wclm import INLIER_GATE

# Minimum number of rays of a line from which the noise is estimated. Origin: chosen; not measured.
MIN_ADAPT_RAYS = 15


@vectorised
def sum_residuals(part: RaySlice, u: float, v: float, sigma_range: float, sigma_bearing: float) -> tuple[float, ...]:
    """Return the sums over the inliers of a line from which the variances of range and bearing are estimated.

    A residual r has variance s p^4 + q t^2 with s the range variance, q that of the bearing, p the predicted 1/rho and
    t its derivative by the bearing. With weights w = 1 / (s p^4 + q t^2), these are the sums of w^2 p^4 r^2,
    w^2 t^2 r^2, w^2 p^8, w^2 p^4 t^2, w^2 t^4, and the number of inliers. The sums of r^2 are increased by n / (n - 2),
    as the line takes two of n degrees of freedom.
    """
    range_variance, bearing_variance = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    by_range = by_bearing = ranges = mixed = bearings = used = 0.0
    for i in range(len(part.inverse)):
        p, t = u * part.cos[i] + v * part.sin[i], v * part.cos[i] - u * part.sin[i]
        residual = part.inverse[i] * (1.0 - range_variance * part.inverse[i] * part.inverse[i]) - p
        quartic, square = p * p * p * p, t * t
        w = 1.0 / (range_variance * quartic + bearing_variance * square)
        inlier = 1.0 if w * residual * residual <= INLIER_GATE else 0.0
        weight = inlier * w * w
        by_range += weight * quartic * residual * residual
        by_bearing += weight * square * residual * residual
        ranges += weight * quartic * quartic
        mixed += weight * quartic * square
        bearings += weight * square * square
        used += inlier
    share = used / max(1.0, used - 2.0)
    return share * by_range, share * by_bearing, ranges, mixed, bearings, used


@inlined
def estimate_noise(part: RaySlice, u: float, v: float, settings: Settings, estimate: Floats) -> None:
    """Write the estimates (6,) of three variances from the residuals of a line, each with its weight.

    They are those of a `NoiseEstimate`, each one scoring step on a likelihood. The likelihood of both variances is
    stationary at sum w^2 p^4 (r^2 - s p^4 - q t^2) = 0 and sum w^2 t^2 (r^2 - s p^4 - q t^2) = 0, that of the range
    variance at a given bearing variance at the first of them. The variance of an estimate is 2 / n of its square if n
    rays determine it while the other is unknown, plus that of surfaces, which differ as much as their noise itself. Its
    weight is the inverse: at most one.
    """
    estimate[:] = 0.0
    by_range, by_bearing, ranges, mixed, bearings, _ = sum_residuals(
        part, u, v, settings.sigma_range, settings.sigma_bearing
    )
    if ranges > 0.0:
        estimate[0] = (by_range - settings.sigma_bearing**2 * mixed) / ranges
        estimate[1] = 1.0
    by_range, by_bearing, ranges, mixed, bearings, _ = sum_residuals(
        part, u, v, settings.learned_range, settings.learned_bearing
    )
    determinant = ranges * bearings - mixed * mixed
    if determinant > 0.0:
        estimate[2] = (by_range * bearings - by_bearing * mixed) / determinant
        estimate[4] = (by_bearing * ranges - by_range * mixed) / determinant
        range_rays = settings.learned_range**4 * determinant / bearings
        bearing_rays = settings.learned_bearing**4 * determinant / ranges
        estimate[3], estimate[5] = range_rays / (range_rays + 2.0), bearing_rays / (bearing_rays + 2.0)


@inlined
def median_estimate(estimates: Floats, count: int, column: int) -> tuple[float, float]:
    """Return the median of the first `count` estimates in a column, weighted by the column after it, and all weight.

    If the weights of two estimates are equally large on both sides, it is their mean; without estimates it is NaN.
    """
    total = middle = middles = 0.0
    for i in range(count):
        total += estimates[i, column + 1]
    for i in range(count):
        below = above = 0.0
        for k in range(count):
            if estimates[k, column] < estimates[i, column]:
                below += estimates[k, column + 1]
            elif estimates[k, column] > estimates[i, column]:
                above += estimates[k, column + 1]
        if max(below, above) <= 0.5 * total:
            middle += estimates[i, column]
            middles += 1.0
    return middle / middles, total
