"""Line and corner by Siadat et al., eqs. (31)-(33) and (44)-(48), with the weights of eq. (17).

The line is a x + b y + c = 0 with a^2 + b^2 = 1. The constrained minimum is the eigenvector (a, b) of the smaller
eigenvalue of the weighted scatter about the weighted mean. For equal weights this is the line of Arras and Siegwart.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled, vectorised
from .conversions import covariance_through, uv_of_implicit
from .line_fit import LineFit, ray_arrays
from .types import Floats, Noise


@vectorised
def implicit_line(inverse: Floats, cos: Floats, sin: Floats) -> tuple[float, float, float, float, float, float, float]:
    """Return (a, b, c, mean x, mean y, W, G) with weights 1/rho^2 and their sum W; (a, b) points away from the lidar.

    G is the difference of the eigenvalues of the scatter; the sensitivity of the direction is inverse to it.
    """
    weight = x = y = xx = xy = yy = 0.0
    for i in range(len(inverse)):
        weight += inverse[i] * inverse[i]
        x += inverse[i] * cos[i]
        y += inverse[i] * sin[i]
        xx += cos[i] * cos[i]
        xy += cos[i] * sin[i]
        yy += sin[i] * sin[i]
    x, y = x / weight, y / weight
    xx, xy, yy = xx - weight * x * x, xy - weight * x * y, yy - weight * y * y
    difference, cross = yy - xx, -2.0 * xy
    normal = 0.5 * math.atan2(cross, difference)
    a, b = math.cos(normal), math.sin(normal)
    c = -(a * x + b * y)
    if c > 0.0:
        a, b, c = -a, -b, -c
    return a, b, c, x, y, weight, math.hypot(difference, cross)


@vectorised
def implicit_covariance(
    inverse: Floats,
    cos: Floats,
    sin: Floats,
    line: tuple[float, float, float, float, float, float, float],
    sigma_range: float,
    sigma_bearing: float,
) -> tuple[float, float, float]:
    """Return (V_phi, C_phi_c, V_c) of eqs. (32)-(33), with phi the direction of (a, b): d(a, b) = (-b, a) dphi.

    With q_n, q_t a point's centred coordinates along n = (a, b) and t = (-b, a), and dn, dt its displacement,

        dphi = -(w (q_t dn + q_n dt) + dw q_n q_t) / G
        dc   = -(w dn + dw q_n) / W - (t . mean) dphi

    where dw = -2 w / rho drho, since the weights 1/rho^2 depend on the range.
    """
    a, b, _, x, y, weight, gap = line
    offset = a * y - b * x
    range_variance, bearing_variance = sigma_range * sigma_range, sigma_bearing * sigma_bearing
    vp = vpc = vc = 0.0
    for i in range(len(inverse)):
        c, s, rho = cos[i], sin[i], 1.0 / inverse[i]
        w = inverse[i] * inverse[i]
        dw = -2.0 * w * inverse[i]
        dx, dy = rho * c - x, rho * s - y
        qn, qt = a * dx + b * dy, a * dy - b * dx
        dn, dt = a * c + b * s, a * s - b * c
        phi_range = -(w * (qt * dn + qn * dt) + dw * qn * qt) / gap
        c_range = -(w * dn + dw * qn) / weight - offset * phi_range
        tn, tt = -rho * dt, rho * dn
        phi_bearing = -w * (qt * tn + qn * tt) / gap
        c_bearing = -w * tn / weight - offset * phi_bearing
        vp += range_variance * phi_range * phi_range + bearing_variance * phi_bearing * phi_bearing
        vpc += range_variance * phi_range * c_range + bearing_variance * phi_bearing * c_bearing
        vc += range_variance * c_range * c_range + bearing_variance * c_bearing * c_bearing
    return vp, vpc, vc


@compiled
def fit_siadat(
    inverse: Floats, cos: Floats, sin: Floats, sigma_range: float, sigma_bearing: float
) -> tuple[float, float, float, float, float]:
    """Return (u, v, Cuu, Cuv, Cvv) of the line, for the extractor."""
    line = implicit_line(inverse, cos, sin)
    vp, vpc, vc = implicit_covariance(inverse, cos, sin, line, sigma_range, sigma_bearing)
    a, b, c = line[0], line[1], line[2]
    # (u, v) = -(a, b) / c
    up, uc, wp, wc = b / c, a / (c * c), -a / c, b / (c * c)
    return (
        -a / c,
        -b / c,
        up * up * vp + 2.0 * up * uc * vpc + uc * uc * vc,
        up * wp * vp + (up * wc + uc * wp) * vpc + uc * wc * vc,
        wp * wp * vp + 2.0 * wp * wc * vpc + wc * wc * vc,
    )


def fit(ranges: Floats, angles: Floats, noise: Noise) -> LineFit:
    """Fit the line of eqs. (31)-(33); the fit's own parameters are (a, b, c), of covariance rank 2.

    `ranges` (n,) in metres and `angles` (n,) in radians are the rays of one wall, n >= 2, in the lidar's frame.
    """
    inverse, cos, sin = ray_arrays(ranges, angles)
    line = implicit_line(inverse, cos, sin)
    vp, vpc, vc = implicit_covariance(inverse, cos, sin, line, noise.sigma_range, noise.sigma_bearing)
    a, b, c = line[:3]
    turn = np.array([[-b, 0.0], [a, 0.0], [0.0, 1.0]])
    parameters = np.array([a, b, c])
    parameter_covariance = covariance_through(turn, np.array([[vp, vpc], [vpc, vc]]))
    uv, jacobian = uv_of_implicit(parameters)
    return LineFit(
        uv=uv,
        covariance=covariance_through(jacobian, parameter_covariance),
        parameters=parameters,
        parameter_covariance=parameter_covariance,
    )


def corner(first: LineFit, second: LineFit) -> tuple[Floats, Floats]:
    """Return position (2,) in metres and covariance (2, 2) of the corner of two (a, b, c) lines, eqs. (44)-(48)."""
    (a1, b1, c1), (a2, b2, c2) = first.parameters, second.parameters
    determinant = a1 * b2 - a2 * b1
    position = np.array([b1 * c2 - b2 * c1, a2 * c1 - a1 * c2]) / determinant
    gradient = np.array([position[0], position[1], 1.0])
    covariance = np.zeros((2, 2))
    for line, direction in (
        (first, np.array([b2, -a2]) / determinant),
        (second, np.array([-b1, a1]) / determinant),
    ):
        covariance += (gradient @ line.parameter_covariance @ gradient) * np.outer(direction, direction)
    return position, covariance
