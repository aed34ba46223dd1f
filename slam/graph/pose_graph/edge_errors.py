"""Errors of a pose graph's edges as g2o defines them, and their Jacobians.

For a pose at t_i with the heading theta_i (as a rotation R_i) that measures a pose or landmark at t_j:

    motions    [R_z' (R_i' (t_j - t_i) - t_z),  wrap(theta_j - theta_i - theta_z)]
    positions  R_i' (t_j - t_i) - z
    bearings   wrap(atan2(R_i' (t_j - t_i)) - z)

GTSAM is not used here: its Pose2 defines a motion's error by the logarithm, which has another optimum.

Each function takes the variables of k edges, (k, 6) = [x_i, y_i, theta_i, x_j, y_j, theta_j] or
(k, 5) = [x_i, y_i, theta_i, x_j, y_j], and the measurements (k, d), and returns the errors (k, d) and their Jacobians
(k, d, 6 or 5).
"""

from __future__ import annotations

import numpy as np

from drivers.se2 import wrap

from ...geometry.segments import Floats

# Metres; for landmarks nearer to the pose the Jacobian of the bearing is limited to its value at this distance.
# Origin: numerical.
MIN_DISTANCE = 1e-6


def motion_errors(variables: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Compute errors (k, 3) and Jacobians (k, 3, 6) of poses measured from poses."""
    relative, derivative = _relative_position(variables)
    c, s = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    to_frame = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    error = np.empty((len(variables), 3))
    error[:, :2] = (to_frame @ (relative - measured[:, :2])[:, :, None])[:, :, 0]
    error[:, 2] = wrap(variables[:, 5] - variables[:, 2] - measured[:, 2])
    jacobian = np.zeros((len(variables), 3, 6))
    jacobian[:, :2, :5] = to_frame @ derivative
    jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
    return error, jacobian


def position_errors(variables: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Compute errors (k, 2) and Jacobians (k, 2, 5) of landmarks measured by position."""
    relative, derivative = _relative_position(variables)
    return relative - measured, derivative


def bearing_errors(variables: Floats, measured: Floats) -> tuple[Floats, Floats]:
    """Compute errors (k, 1) and Jacobians (k, 1, 5) of landmarks measured by bearing."""
    relative, derivative = _relative_position(variables)
    error = wrap(np.arctan2(relative[:, 1:], relative[:, :1]) - measured)
    across = np.stack([-relative[:, 1], relative[:, 0]], axis=-1)
    by_position = across / np.maximum((relative**2).sum(axis=1), MIN_DISTANCE**2)[:, None]
    return error, by_position[:, None, :] @ derivative


def _relative_position(variables: Floats) -> tuple[Floats, Floats]:
    """Return R_i' (t_j - t_i), (k, 2), and its Jacobian by [x_i, y_i, theta_i, x_j, y_j], (k, 2, 5)."""
    c, s = np.cos(variables[:, 2]), np.sin(variables[:, 2])
    to_frame = np.array([[c, s], [-s, c]]).transpose(2, 0, 1)
    relative = (to_frame @ (variables[:, 3:5] - variables[:, :2])[:, :, None])[:, :, 0]
    derivative = np.empty((len(variables), 2, 5))
    derivative[:, :, :2], derivative[:, :, 3:] = -to_frame, to_frame
    derivative[:, 0, 2], derivative[:, 1, 2] = relative[:, 1], -relative[:, 0]
    return relative, derivative
