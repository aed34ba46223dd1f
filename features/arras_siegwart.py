"""Line and corner by Arras and Siegwart, eqs. (26)-(30) and (39)-(43), with the weights of eq. (17).

The line is x cos(alpha) + y sin(alpha) = r. With z = rho exp(i theta), W = sum w, Z1 = sum w z and the centred second
moment Z = sum w z^2 - Z1^2 / W, eq. (28) reads alpha = arg(-Z) / 2: the double sums of eqs. (27)-(28) are products of
single sums, so that the estimate costs O(n).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from .compiled import compiled, vectorised
from .conversions import covariance_through, uv_of_polar
from .line_fit import LineFit, ray_arrays
from .types import Floats, Noise


@vectorised
def direction_by_single_sums(inverse: Floats, cos: Floats, sin: Floats) -> tuple[float, float]:
    """Return numerator and denominator of tan(2 alpha), eq. (27), with w = 1/rho^2: -Im Z and -Re Z."""
    weight = x = y = xx = xy = 0.0
    for i in range(len(inverse)):
        weight += inverse[i] * inverse[i]
        x += inverse[i] * cos[i]
        y += inverse[i] * sin[i]
        xx += cos[i] * cos[i] - sin[i] * sin[i]
        xy += 2.0 * cos[i] * sin[i]
    return 2.0 * x * y / weight - xy, (x * x - y * y) / weight - xx


@compiled
def direction_by_double_sums(inverse: Floats, cos: Floats, sin: Floats) -> tuple[float, float]:
    """Return numerator and denominator of tan(2 alpha) as printed in eq. (27), O(n^2)."""
    weight = numerator = denominator = single_sine = single_cosine = 0.0
    for i in range(len(inverse)):
        weight += inverse[i] * inverse[i]
        single_sine += 2.0 * sin[i] * cos[i]
        single_cosine += cos[i] * cos[i] - sin[i] * sin[i]
        for j in range(len(inverse)):
            product = inverse[i] * inverse[j]  # w_i rho_i w_j rho_j
            numerator += 2.0 * product * sin[i] * cos[j]
            denominator += product * (cos[i] * cos[j] - sin[i] * sin[j])
    return numerator / weight - single_sine, denominator / weight - single_cosine


@vectorised
def polar_line(
    inverse: Floats,
    cos: Floats,
    sin: Floats,
    numerator: float,
    denominator: float,
) -> tuple[float, float, float, float, float]:
    """Return (r, alpha, mean x, mean y, W) of eqs. (26) and (28) from the direction's numerator and denominator."""
    alpha = 0.5 * math.atan2(numerator, denominator)
    ca, sa = math.cos(alpha), math.sin(alpha)
    weight = x = y = 0.0
    for i in range(len(inverse)):
        weight += inverse[i] * inverse[i]
        x += inverse[i] * cos[i]
        y += inverse[i] * sin[i]
    x, y = x / weight, y / weight
    r = x * ca + y * sa
    if r < 0.0:
        r, alpha = -r, alpha + math.pi
    return r, alpha, x, y, weight


@vectorised
def polar_covariance(
    inverse: Floats,
    cos: Floats,
    sin: Floats,
    numerator: float,
    denominator: float,
    line: tuple[float, float, float, float, float],
    sigma_range: float,
    sigma_bearing: float,
) -> tuple[float, float, float]:
    """Return (Vr, Cra, Valpha) of eqs. (29)-(30) of a line that `polar_line` has found.

    With q = z - mean(z), k = Im(exp(-i alpha) mean(z)) and dz = exp(i theta) drho or i z dtheta, a ray contributes

        dalpha = Im(w q dz / Z) + Im(dw q^2 / Z) / 2
        dr     = Re(exp(-i alpha) (w dz + dw q)) / W + k dalpha

    where dw = -2 w / rho drho, since the weights 1/rho^2 depend on the range.
    """
    _, alpha, x, y, weight = line
    ca, sa = math.cos(alpha), math.sin(alpha)
    k = y * ca - x * sa
    size = denominator * denominator + numerator * numerator
    zr, zi = -denominator / size, numerator / size  # 1/Z
    range_variance, bearing_variance = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    vr = vra = va = 0.0
    for i in range(len(inverse)):
        c, s, rho = cos[i], sin[i], 1.0 / inverse[i]
        w = inverse[i] * inverse[i]
        qx, qy = rho * c - x, rho * s - y
        dw = -2.0 * w * inverse[i]
        mr, mi = w * (qx * c - qy * s) + 0.5 * dw * (qx * qx - qy * qy), w * (qx * s + qy * c) + dw * qx * qy
        alpha_range = mr * zi + mi * zr
        r_range = (ca * (w * c + dw * qx) + sa * (w * s + dw * qy)) / weight + k * alpha_range
        tr, ti = -w * rho * (qx * s + qy * c), w * rho * (qx * c - qy * s)
        alpha_bearing = tr * zi + ti * zr
        r_bearing = w * rho * (sa * c - ca * s) / weight + k * alpha_bearing
        vr += range_variance * r_range * r_range + bearing_variance * r_bearing * r_bearing
        vra += range_variance * r_range * alpha_range + bearing_variance * r_bearing * alpha_bearing
        va += range_variance * alpha_range * alpha_range + bearing_variance * alpha_bearing * alpha_bearing
    return vr, vra, va


@compiled
def fit_arras_siegwart(
    inverse: Floats, cos: Floats, sin: Floats, sigma_range: float, sigma_bearing: float
) -> tuple[float, float, float, float, float]:
    """Return (u, v, Cuu, Cuv, Cvv) of the line, for the extractor."""
    numerator, denominator = direction_by_single_sums(inverse, cos, sin)
    line = polar_line(inverse, cos, sin, numerator, denominator)
    vr, vra, va = polar_covariance(inverse, cos, sin, numerator, denominator, line, sigma_range, sigma_bearing)
    r, alpha = line[0], line[1]
    c, s = math.cos(alpha), math.sin(alpha)
    ur, ua, wr, wa = -c / (r * r), -s / r, -s / (r * r), c / r
    return (
        c / r,
        s / r,
        ur * ur * vr + 2.0 * ur * ua * vra + ua * ua * va,
        ur * wr * vr + (ur * wa + ua * wr) * vra + ua * wa * va,
        wr * wr * vr + 2.0 * wr * wa * vra + wa * wa * va,
    )


def fit(ranges: Floats, angles: Floats, noise: Noise, *, sums: Literal["single", "double"] = "single") -> LineFit:
    """Fit the line of eqs. (26)-(30); the fit's own parameters are (r, alpha), metres and radians.

    `ranges` (n,) in metres and `angles` (n,) in radians are the rays of one wall, n >= 2, in the lidar's frame.
    `sums="double"` evaluates eq. (27) as printed, in O(n^2); the result is the same.
    """
    inverse, cos, sin = ray_arrays(ranges, angles)
    direction = direction_by_double_sums if sums == "double" else direction_by_single_sums
    numerator, denominator = direction(inverse, cos, sin)
    line = polar_line(inverse, cos, sin, numerator, denominator)
    vr, vra, va = polar_covariance(
        inverse, cos, sin, numerator, denominator, line, noise.sigma_range, noise.sigma_bearing
    )
    parameters, parameter_covariance = np.array(line[:2]), np.array([[vr, vra], [vra, va]])
    uv, jacobian = uv_of_polar(parameters)
    return LineFit(
        uv=uv,
        covariance=covariance_through(jacobian, parameter_covariance),
        parameters=parameters,
        parameter_covariance=parameter_covariance,
    )


def corner(first: LineFit, second: LineFit) -> tuple[Floats, Floats]:
    """Return position (2,) in metres and covariance (2, 2) of the corner of two (r, alpha) lines, eqs. (39)-(43)."""
    (r1, a1), (r2, a2) = first.parameters, second.parameters
    sine = math.sin(a2 - a1)
    position = np.array([r1 * math.sin(a2) - r2 * math.sin(a1), r2 * math.cos(a1) - r1 * math.cos(a2)]) / sine
    covariance = np.zeros((2, 2))
    for line, direction in (
        (first, np.array([math.sin(a2), -math.cos(a2)]) / sine),
        (second, np.array([-math.sin(a1), math.cos(a1)]) / sine),
    ):
        alpha = line.parameters[1]
        along = position @ np.array([-math.sin(alpha), math.cos(alpha)])
        gradient = np.array([1.0, -along])  # of the line's displacement at the corner, in (r, alpha)
        covariance += (gradient @ line.parameter_covariance @ gradient) * np.outer(direction, direction)
    return position, covariance
