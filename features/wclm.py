"""Weighted conformal lidar mapping (WCLM): the line fit of eqs. (17)-(25) and its maximum-likelihood form.

Inversion sends the line at distance d and normal angle alpha to one point Q = (x_Q, y_Q), eqs. (1)-(2). The working
parameters are (u, v) = (x_Q, -y_Q): the line is u x + v y = 1, and a ray of bearing theta and range rho on it obeys

    u cos(theta) + v sin(theta) = 1 / rho,

which is linear in (u, v). With the weights of eq. (17), w ~ 1/rho^2, the fit (18)-(19) is therefore ordinary least
squares of 1/rho on (cos theta, sin theta), and needs only six sums over the rays, for any weights w:

    W = sum w      E = sum w exp(2 i theta)      H = sum w (1/rho) exp(i theta)      K = sum w (1/rho)^2

The maximum-likelihood form weights each ray by the inverse variance of its 1/rho, which is

    sigma_range^2 p^4 + sigma_bearing^2 t^2,      p = u cos(theta) + v sin(theta),      t = v cos(theta) - u sin(theta),

with its predicted 1/rho, p, and the slope t of p in bearing. With the measured 1/rho, rays measured too long would have
larger weights than rays measured too short, and the line would be biased. Two corrections make the sums unbiased: noise
makes 1/rho too large by sigma_range^2 / rho^3 on average, and shrinks exp(i k theta) by exp(-k^2 sigma_bearing^2 / 2).
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import vectorised
from .line_fit import LineFit, ray_arrays
from .normal_equations import Sums, solve_line
from .normal_limits import GROSS_LIMIT
from .types import Floats, Noise

# Maximum squared normalised residual of an inlier.
INLIER_GATE = GROSS_LIMIT**2  # Origin: definition.

# Number of reweightings of the maximum-likelihood fit. Origin: measured, from a least-squares fit the first one comes
# within 1 % of the optimum.
REWEIGHTINGS = 2


@vectorised
def least_squares(inverse: Floats, cos: Floats, sin: Floats) -> tuple[float, float, float, float, float, float]:
    """Return (u, v, n, Er, Ei, D) of the unweighted fit to `inverse` = 1/rho: eqs. (18)-(19) with the weights (17)."""
    er = ei = hr = hi = 0.0
    for i in range(len(inverse)):
        er += cos[i] * cos[i] - sin[i] * sin[i]
        ei += 2.0 * cos[i] * sin[i]
        hr += inverse[i] * cos[i]
        hi += inverse[i] * sin[i]
    count = float(len(inverse))
    u, v, determinant = solve_line(Sums(count, er, ei, hr, hi, math.nan))
    return u, v, count, er, ei, determinant


@vectorised
def fit_wclm(
    inverse: Floats, cos: Floats, sin: Floats, sigma_range: float, sigma_bearing: float
) -> tuple[float, float, float, float, float]:
    """Return (u, v, Cuu, Cuv, Cvv) of the fit (18)-(19) with the covariance (22)-(25).

    With N^-1 z = a z + b conj(z), a = 2n/D and b = -2E/D, the derivatives of B = u + i v are exactly

        dB/drho_i   = -(1/rho_i)^2 (a e_i + b conj(e_i))                      e_i = exp(i theta_i)
        dB/dtheta_i = a G_i + b conj(G_i)                                     G_i = i e_i (1/rho_i - e_i conj(B))

    They contain the dependence of the weights (17) on the range. Equations (23)-(25) are these derivatives in real
    form: -w A/(M rho), +w B/(M rho) and -w C/M, -w D/M, where R_i appears in C and D only.
    """
    u, v, count, er, ei, determinant = least_squares(inverse, cos, sin)
    if not determinant > 0.0:
        return math.nan, math.nan, math.nan, math.nan, math.nan
    a, br, bi = 2.0 * count / determinant, -2.0 * er / determinant, -2.0 * ei / determinant
    range_variance, bearing_variance = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    cuu = cuv = cvv = 0.0
    for i in range(len(inverse)):
        c, s, eta = cos[i], sin[i], inverse[i]
        square = eta * eta
        du = -square * (a * c + br * c + bi * s)
        dv = -square * (a * s + bi * c - br * s)
        # G = i e (eta - e conj(B)); e conj(B) = predicted 1/rho and, with the opposite sign, its slope in bearing
        fr, fi = eta - (u * c + v * s), v * c - u * s
        gr, gi = -(s * fr + c * fi), c * fr - s * fi
        tu = a * gr + br * gr + bi * gi
        tv = a * gi + bi * gr - br * gi
        cuu += range_variance * du * du + bearing_variance * tu * tu
        cuv += range_variance * du * dv + bearing_variance * tu * tv
        cvv += range_variance * dv * dv + bearing_variance * tv * tv
    return u, v, cuu, cuv, cvv


@vectorised
def reweighted(
    inverse: Floats,
    cos: Floats,
    sin: Floats,
    u: float,
    v: float,
    sigma_range: float,
    sigma_bearing: float,
    learned_range: float,
    learned_bearing: float,
    gate: float,
) -> tuple[float, float, float, float, float, float, int]:
    """Reweight the maximum-likelihood fit once, from the line (u, v).

    inverse, cos, sin                (n,) 1/range of the rays, 1/metres, and cosine and sine of their bearings
    sigma_range, sigma_bearing       noise of a ray for the weights, metres and radians
    learned_range, learned_bearing   noise of a ray for the covariance
    gate                             squared normalised residual up to which a ray is an inlier

    Returns (u, v, Cuu, Cuv, Cvv, chi2, number of inliers). The weights are those of the first noise; the covariance is
    that of these weights if the noise is the second one: with the normal matrix N and the variances S of the rays,
    N^-1 A' W S W A N^-1, which is N^-1 if both are the same.
    """
    range_variance, bearing_variance = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    total = er = ei = hr = hi = k = used = learned = lr = li = 0.0
    for i in range(len(inverse)):
        c, s = cos[i], sin[i]
        eta = inverse[i] * (1.0 - range_variance * inverse[i] * inverse[i])
        p, t = u * c + v * s, v * c - u * s
        w = 1.0 / (range_variance * p * p * p * p + bearing_variance * t * t)
        residual = eta - p
        inlier = 1.0 if w * residual * residual <= gate else 0.0
        w *= inlier
        used += inlier
        m = w * w * (learned_range * learned_range * p * p * p * p + learned_bearing * learned_bearing * t * t)
        total += w
        er += w * (c * c - s * s)
        ei += 2.0 * w * c * s
        learned += m
        lr += m * (c * c - s * s)
        li += 2.0 * m * c * s
        hr += w * eta * c
        hi += w * eta * s
        k += w * eta * eta
    shrunk, halved = 1.0 + 2.0 * bearing_variance, 1.0 + 0.5 * bearing_variance
    u, v, determinant = solve_line(Sums(total, shrunk * er, shrunk * ei, halved * hr, halved * hi, k))
    if not determinant > 0.0:
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, 0
    squares = 0.5 * (total * (u * u + v * v) + er * (u * u - v * v)) + ei * u * v
    chi2 = max(0.0, k - 2.0 * (u * hr + v * hi) + squares)
    scale = 2.0 / determinant
    nuu, nuv, nvv = scale * (total - shrunk * er), -scale * shrunk * ei, scale * (total + shrunk * er)
    luu, luv, lvv = 0.5 * (learned + shrunk * lr), 0.5 * shrunk * li, 0.5 * (learned - shrunk * lr)
    cuu, cuv, cvv = sandwich(nuu, nuv, nvv, luu, luv, lvv)
    return u, v, cuu, cuv, cvv, chi2, int(used)


@vectorised
def sandwich(nuu: float, nuv: float, nvv: float, luu: float, luv: float, lvv: float) -> tuple[float, float, float]:
    """Return the entries uu, uv, vv of N L N, given those of the symmetric matrices N and L (2, 2)."""
    return (
        nuu * nuu * luu + 2.0 * nuu * nuv * luv + nuv * nuv * lvv,
        nuu * nuv * luu + (nuu * nvv + nuv * nuv) * luv + nuv * nvv * lvv,
        nuv * nuv * luu + 2.0 * nuv * nvv * luv + nvv * nvv * lvv,
    )


def fit(ranges: Floats, angles: Floats, noise: Noise) -> LineFit:
    """Fit the paper's line: eqs. (18)-(19), weights (17), covariance (20)-(25).

    `ranges` (n,) in metres and `angles` (n,) in radians are the rays of one wall, n >= 2, in the lidar's frame. The
    fit's own parameters are (x_Q, y_Q) in 1/metres.
    """
    inverse, cos, sin = ray_arrays(ranges, angles)
    u, v, cuu, cuv, cvv = fit_wclm(inverse, cos, sin, noise.sigma_range, noise.sigma_bearing)
    return LineFit(
        uv=np.array([u, v]),
        covariance=np.array([[cuu, cuv], [cuv, cvv]]),
        parameters=np.array([u, -v]),
        parameter_covariance=np.array([[cuu, -cuv], [-cuv, cvv]]),
    )


def fit_maximum_likelihood(ranges: Floats, angles: Floats, noise: Noise) -> LineFit:
    """Fit the maximum-likelihood line (WCLM-ML): the fit (18)-(19), reweighted by each ray's own variance.

    Arguments as for `fit`. All rays are used. The fit's own parameters are (u, v); the covariance is that of the
    weighted normal equations.
    """
    inverse, cos, sin = ray_arrays(ranges, angles)
    u, v = least_squares(inverse, cos, sin)[:2]
    cuu = cuv = cvv = math.nan
    for _ in range(REWEIGHTINGS):
        u, v, cuu, cuv, cvv, _, _ = reweighted(
            inverse,
            cos,
            sin,
            u,
            v,
            noise.sigma_range,
            noise.sigma_bearing,
            noise.sigma_range,
            noise.sigma_bearing,
            math.inf,
        )
    uv, covariance = np.array([u, v]), np.array([[cuu, cuv], [cuv, cvv]])
    return LineFit(uv=uv, covariance=covariance, parameters=uv, parameter_covariance=covariance)
