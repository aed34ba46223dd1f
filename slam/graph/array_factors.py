"""Errors of factors as arrays, their Jacobians, and the normal equations they add to: the arithmetic of `array_graph`.

A pose or the frame of a wall is [x, y, heading], a corner [x, y, 0]. Steps of poses are in their own frames, and the
error of a relative pose is its logarithm in SE(2) as seen from the measured one. A factor k has

forms        (f,) PRIOR, BETWEEN or POINT
ends         (f, 2) rows of its variables; the same one twice for a prior
measured     (f, 3) the pose, the relative pose, or bearing and range
information  (f, 3, 3) of the error; may be singular
scales       (f,) of the Cauchy kernel, infinite if the factor has none
"""

from __future__ import annotations

import math

import numpy as np

from drivers.compiled import compiled, inlined

from ..geometry.angles import axes_of, wrap_angle

# The measurements of factors: a pose, a pose relative to another one, and bearing and range of a point.
# Origin: definition.
PRIOR, BETWEEN, POINT = 0, 1, 2
# Radians; smaller angles are taken as zero in quotients. Origin: numerical.
MIN_ANGLE = 1e-9


@inlined
def _error(form, measured, first, second, axis, error):  # type: ignore[no-untyped-def]
    """Compute the error (3,) of a factor: of a pose, the logarithm of the estimate as seen from the measurement.

    `axis` (2,) is the unit vector along the heading of `first`.
    """
    if form == PRIOR:
        x, y, turn = second[0] - measured[0], second[1] - measured[1], wrap_angle(second[2] - measured[2])
        c, s = math.cos(measured[2]), math.sin(measured[2])
        x, y = c * x + s * y, c * y - s * x
    else:
        x, y, c, s = second[0] - first[0], second[1] - first[1], axis[0], axis[1]
        x, y = c * x + s * y, c * y - s * x
        if form == POINT:
            error[0], error[1], error[2] = (
                wrap_angle(math.atan2(y, x) - measured[0]),
                math.hypot(x, y) - measured[1],
                0.0,
            )
            return
        x, y, turn = x - measured[0], y - measured[1], wrap_angle(second[2] - first[2] - measured[2])
        c, s = math.cos(measured[2]), math.sin(measured[2])
        x, y = c * x + s * y, c * y - s * x
    half = 0.5 * turn
    a = half / math.tan(half) if abs(turn) > MIN_ANGLE else 1.0
    error[0], error[1], error[2] = a * x + half * y, a * y - half * x, turn


@inlined
def _squared(error, information):  # type: ignore[no-untyped-def]
    """Return the squared Mahalanobis distance of an error (3,)."""
    total = 0.0
    for r in range(3):
        for c in range(3):
            total += error[r] * information[r, c] * error[c]
    return total


@inlined
def _jacobians(form, first, second, axis, other_axis, error, of_first, of_second):  # type: ignore[no-untyped-def]
    """Compute the Jacobians (3, 3) of an error by both variables, whose headings have the unit vectors `axis` and
    `other_axis` (2,)."""
    dx, dy = second[0] - first[0], second[1] - first[1]
    of_first[:], of_second[:] = 0.0, 0.0
    if form == PRIOR:
        _invert_right_jacobian(error, of_first)
        return
    c, s = axis[0], axis[1]
    if form == POINT:
        x, y = c * dx + s * dy, c * dy - s * dx
        distance = math.hypot(x, y)
        along, across = (x / distance, y / distance), (-y / distance**2, x / distance**2)
        for r, (u, v) in enumerate((across, along)):
            of_first[r, 0], of_first[r, 1], of_first[r, 2] = -u, -v, u * y - v * x
            of_second[r, 0], of_second[r, 1] = u * c - v * s, u * s + v * c
        return
    _invert_right_jacobian(error, of_second)
    # times minus the adjoint of the first variable as seen from the second one
    cs, ss = other_axis[0], other_axis[1]
    c, s = cs * axis[0] + ss * axis[1], ss * axis[0] - cs * axis[1]
    x, y = -cs * dx - ss * dy, ss * dx - cs * dy
    for r in range(3):
        u, v, w = of_second[r, 0], of_second[r, 1], of_second[r, 2]
        of_first[r, 0], of_first[r, 1], of_first[r, 2] = s * v - c * u, -s * u - c * v, v * x - u * y - w


@inlined
def _invert_right_jacobian(error, inverse):  # type: ignore[no-untyped-def]
    """Compute the inverse (3, 3) of the right Jacobian of SE(2) at an error."""
    turn, half = error[2], 0.5 * error[2]
    a = half / math.tan(half) if abs(turn) > MIN_ANGLE else 1.0
    b = (1.0 - a) / turn if abs(turn) > MIN_ANGLE else 0.0
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = a, -half, error[0] * b + 0.5 * error[1]
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = half, a, error[1] * b - 0.5 * error[0]
    inverse[2, 2] = 1.0


@inlined
def _weigh(weight, information, jacobian, result):  # type: ignore[no-untyped-def]
    """Compute the product of a weight, an information and a Jacobian, each (3, 3)."""
    for r in range(3):
        x, y, z = weight * information[r, 0], weight * information[r, 1], weight * information[r, 2]
        for c in range(3):
            result[r, c] = x * jacobian[0, c] + y * jacobian[1, c] + z * jacobian[2, c]


@inlined
def _add_product_of_transposed(target, a, b):  # type: ignore[no-untyped-def]
    """Add a' b to a block (3, 3)."""
    for r in range(3):
        x, y, z = a[0, r], a[1, r], a[2, r]
        for c in range(3):
            target[r, c] += x * b[0, c] + y * b[1, c] + z * b[2, c]


@inlined
def _subtract_product_with_error(target, weighted, error):  # type: ignore[no-untyped-def]
    """Subtract the product of a transposed weighted Jacobian with an error from a right side (3,)."""
    for c in range(3):
        target[c] -= weighted[0, c] * error[0] + weighted[1, c] * error[1] + weighted[2, c] * error[2]


@compiled
def robust_cost(forms, ends, measured, information, scales, values):  # type: ignore[no-untyped-def]
    """Return twice the robust cost of the factors at `values` (n, 3)."""
    return _robust_cost(forms, ends, measured, information, scales, values, axes_of(values), np.zeros(3))


@compiled
def squared_distances(forms, ends, measured, information, values):  # type: ignore[no-untyped-def]
    """Return the squared Mahalanobis distance (f,) of each factor at `values` (n, 3), without robust kernels."""
    axes, error, result = axes_of(values), np.zeros(3), np.empty(len(forms))
    for k in range(len(forms)):
        first, second = ends[k]
        _error(forms[k], measured[k], values[first], values[second], axes[first], error)
        # across the only direction that a factor measures, rounding can give less than zero
        result[k] = max(_squared(error, information[k]), 0.0)
    return result


@inlined
def _robust_cost(forms, ends, measured, information, scales, values, axes, error):  # type: ignore[no-untyped-def]
    """Return twice the robust cost, given the unit vectors along all headings; `error` (3,) is overwritten."""
    total = 0.0
    for k in range(len(forms)):
        first, second = ends[k]
        _error(forms[k], measured[k], values[first], values[second], axes[first], error)
        squared = _squared(error, information[k])
        scale = scales[k] ** 2
        total += squared if scale == np.inf else scale * math.log1p(squared / scale)
    return total


@compiled
def add_normal_equations(  # type: ignore[no-untyped-def]
    forms, ends, measured, information, scales, values, rank, slots, diagonal, below, right
):
    """Add the normal equations of all factors at `values` (n, 3), with robust weights, to a matrix and its right side.

    rank             (n,) block of each variable in the matrix
    slots            (f,) block of `below` that a factor adds to
    diagonal, below  blocks (n, 3, 3) and (b, 3, 3) of the matrix
    right            (n, 3)
    """
    factors, matrix = (forms, ends, measured, information, scales), (rank, slots, diagonal, below, right)
    _add_all(factors, values, axes_of(values), matrix, np.zeros(3), np.zeros((4, 3, 3)))


@inlined
def _add_all(factors, values, axes, matrix, error, jacobians):  # type: ignore[no-untyped-def]
    """Add the normal equations, given the unit vectors along all headings.

    `error` (3,) and `jacobians` (4, 3, 3), those by both variables and the same weighted, are overwritten.
    """
    forms, ends, measured, information, scales = factors
    rank, slots, diagonal, below, right = matrix
    of_first, of_second, weighted_first, weighted_second = jacobians[0], jacobians[1], jacobians[2], jacobians[3]
    for k in range(len(forms)):
        first, second = ends[k]
        _error(forms[k], measured[k], values[first], values[second], axes[first], error)
        _jacobians(forms[k], values[first], values[second], axes[first], axes[second], error, of_first, of_second)
        weight = 1.0 / (1.0 + _squared(error, information[k]) / scales[k] ** 2)
        _weigh(weight, information[k], of_first, weighted_first)
        _weigh(weight, information[k], of_second, weighted_second)
        i, j = rank[first], rank[second]
        _add_product_of_transposed(diagonal[i], of_first, weighted_first)
        _subtract_product_with_error(right[i], weighted_first, error)
        if forms[k] == PRIOR:
            continue
        _add_product_of_transposed(diagonal[j], of_second, weighted_second)
        _subtract_product_with_error(right[j], weighted_second, error)
        if i < j:
            _add_product_of_transposed(below[slots[k]], of_second, weighted_first)
        else:
            _add_product_of_transposed(below[slots[k]], of_first, weighted_second)


@compiled
def moved(values, step, corners):  # type: ignore[no-untyped-def]
    """Return the values moved by a step: poses by its exponential in their own frames."""
    result = values.copy()
    for k in range(len(values)):
        x, y, turn = step[k]
        if corners[k]:
            result[k, 0] += x
            result[k, 1] += y
            continue
        a, b = (math.sin(turn) / turn, 2.0 * math.sin(0.5 * turn) ** 2 / turn) if abs(turn) > MIN_ANGLE else (1.0, 0.0)
        x, y = a * x - b * y, b * x + a * y
        c, s = math.cos(values[k, 2]), math.sin(values[k, 2])
        result[k, 0] += c * x - s * y
        result[k, 1] += s * x + c * y
        result[k, 2] = wrap_angle(values[k, 2] + turn)
    return result
