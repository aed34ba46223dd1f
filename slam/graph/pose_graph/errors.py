"""How far measurements of a pose graph are from an estimate: g2o's errors and their derivatives.

For a pose at t_i with the heading theta_i (as a rotation R_i) that measures what is at t_j:

    motions    [R_z' (R_i' (t_j - t_i) - t_z),  wrap(theta_j - theta_i - theta_z)]
    positions  R_i' (t_j - t_i) - z
    bearings   wrap(atan2(R_i' (t_j - t_i)) - z)

GTSAM is not used here: its Pose2 measures a motion's error by the logarithm, whose optimum is another one.

Each function takes the variables that the k edges touch, (k, 6) = [x_i, y_i, theta_i, x_j, y_j, theta_j] or
(k, 5) = [x_i, y_i, theta_i, x_j, y_j], and the measurements (k, d), and returns the errors (k, d) and their derivatives
(k, d, 6 or 5).
"""

from __future__ import annotations

import numpy as np

from drivers.se2 import wrap

from .model import Floats

NEAREST = 1e-6
"""Metres; nearer to a pose than this, a landmark's bearing has the derivative that it has at this distance."""


def motion_errors(touched: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Of poses measured from poses: (k, 3) and (k, 3, 6)."""
    seen, derivative = _seen(touched)
    c, s = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    back = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    error = np.empty((len(touched), 3))
    error[:, :2] = (back @ (seen - measured[:, :2])[:, :, None])[:, :, 0]
    error[:, 2] = wrap(touched[:, 5] - touched[:, 2] - measured[:, 2])
    jacobian = np.zeros((len(touched), 3, 6))
    jacobian[:, :2, :5] = back @ derivative
    jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
    return error, jacobian


def position_errors(touched: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Of landmarks whose position is measured: (k, 2) and (k, 2, 5)."""
    seen, derivative = _seen(touched)
    return seen - measured, derivative


def bearing_errors(touched: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Of landmarks whose direction is measured: (k, 1) and (k, 1, 5)."""
    seen, derivative = _seen(touched)
    error = wrap(np.arctan2(seen[:, 1:], seen[:, :1]) - measured)
    across = np.stack([-seen[:, 1], seen[:, 0]], axis=-1)
    turning = across / np.maximum((seen**2).sum(axis=1), NEAREST**2)[:, None]
    return error, turning[:, None, :] @ derivative


def _seen(touched: Floats) -> tuple[Floats, Floats]:
    """R_i' (t_j - t_i), (k, 2), and its derivatives by [x_i, y_i, theta_i, x_j, y_j], (k, 2, 5)."""
    c, s = np.cos(touched[:, 2]), np.sin(touched[:, 2])
    back = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    seen = (back @ (touched[:, 3:5] - touched[:, :2])[:, :, None])[:, :, 0]
    derivative = np.empty((len(touched), 2, 5))
    derivative[:, :, :2], derivative[:, :, 3:] = -back, back
    derivative[:, 0, 2], derivative[:, 1, 2] = seen[:, 1], -seen[:, 0]
    return seen, derivative
