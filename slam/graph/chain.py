"""Smooth a trajectory: a chain of poses, each with a measured pose and odometry to the next."""

from __future__ import annotations

import numpy as np

from ..errors import MapError
from ..geometry.degeneracy import MIN_INFORMATION
from ..geometry.segments import Floats
from .array_factors import BETWEEN, PRIOR, add_normal_equations, moved, robust_cost
from .block_cholesky import factorise, solve
from .block_pattern import Pattern
from .factors import MOTION_CAUCHY_SCALE

# Damping of the first step, per square metre and square radian; it is divided by DAMPING_FACTOR after a step that
# lowers the cost, and multiplied otherwise, up to MAX_DAMPING. Origin: numerical, the defaults of GTSAM.
FIRST_DAMPING, DAMPING_FACTOR, MAX_DAMPING = 1e-5, 10.0, 1e5
# Decrease of the cost, also relative to the cost, below which a step is the last one. Origin: numerical, the default of
# GTSAM.
LAST_DECREASE = 1e-5
# Steps at most. Origin: numerical, the default of GTSAM.
MAX_STEPS = 100


def smooth_chain(poses: Floats, informations: Floats, motions: Floats, covariances: Floats) -> Floats:
    """Return the most likely poses (n, 3) of a trajectory, by Levenberg-Marquardt.

    poses         (n, 3) measured
    informations  (n, 3, 3) of the measured poses, each in its pose's own frame; may be singular
    motions       (n - 1, 3) from each pose to the next, by odometry; with a robust kernel
    covariances   (n - 1, 3, 3) of the motions, in the frames at their ends

    Raises MapError if the chain is undetermined.
    """
    count, at = len(poses), np.arange(len(poses))
    forms = np.repeat([PRIOR, BETWEEN], [count, count - 1])
    ends = np.concatenate([np.column_stack([at, at]), np.column_stack([at[:-1], at[1:]])])
    measured = np.concatenate([poses, motions])
    information = np.concatenate([informations + MIN_INFORMATION * np.eye(3), np.linalg.inv(covariances)])
    factors = forms, ends, measured, information, np.where(forms == PRIOR, np.inf, MOTION_CAUCHY_SCALE)
    # In the order of the chain, no elimination adds a block: that below the diagonal of column k is in row k + 1.
    pattern = Pattern(at, np.minimum(np.arange(count + 1), count - 1), at[1:], at[:-1])
    slots, corners = np.concatenate([np.zeros(count, dtype=np.int64), pattern.slots]), np.zeros(count, dtype=bool)
    values, cost, damping = poses, 0.5 * float(robust_cost(*factors, poses)), FIRST_DAMPING
    for _ in range(MAX_STEPS):
        diagonal, below = np.tile(damping * np.eye(3), (count, 1, 1)), np.zeros((count - 1, 3, 3))
        gradient = np.zeros((count, 3))
        add_normal_equations(*factors, values, at, slots, diagonal, below, gradient)
        following, lower = values, np.inf
        if factorise(pattern, diagonal, below):
            following = np.asarray(moved(values, solve(pattern, diagonal, below, gradient), corners))
            lower = 0.5 * float(robust_cost(*factors, following))
        least_decrease = LAST_DECREASE * max(1.0, cost)
        if not lower < cost + least_decrease:
            damping *= DAMPING_FACTOR
            if damping > MAX_DAMPING:
                raise MapError("the trajectory cannot be estimated: it is not determined by the measurements")
            continue
        if cost - lower < least_decrease:
            return following if lower < cost else values
        values, cost, damping = following, lower, damping / DAMPING_FACTOR
    return values
