"""Residuals of the factors of a graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.segments import Floats
from .factors import CAUCHY_SCALES, PIN_KINDS, PRIOR_KINDS, Factor, FactorKind
from .residuals import (
    CORNER,
    GAUGE_PRIOR,
    ODOMETRY,
    PIN,
    PLAN,
    POINT_MAP,
    PRIOR,
    SCAN_MATCH,
    SUBMAP_MATCH,
    WALL,
    WALL_EQUALITY,
    Residuals,
)

# Kind of the residuals of a factor, and the number of directions of the error that have information.
# Origin: definition.
_KINDS = {
    FactorKind.POSE_PRIOR: (PRIOR, 3),
    FactorKind.PINNED_POSE: (PRIOR, 3),
    FactorKind.ODOMETRY: (ODOMETRY, 3),
    FactorKind.LOOP: (ODOMETRY, 3),
    FactorKind.GAUGE_PRIOR: (GAUGE_PRIOR, 1),
    FactorKind.WALL_HEADING: (WALL, 1),
    FactorKind.WALL_OFFSET: (WALL, 1),
    FactorKind.CORNER: (CORNER, 2),
    FactorKind.PLAN_WALL: (PLAN, 2),
    FactorKind.PINNED_WALL: (PIN, 2),
    FactorKind.WALL_EQUALITY: (WALL_EQUALITY, 2),
    FactorKind.POINT_MAP: (POINT_MAP, 3),
    FactorKind.SCAN_MATCH: (SCAN_MATCH, 3),
    FactorKind.SUBMAP_MATCH: (SUBMAP_MATCH, 3),
}


def residuals_of(factors: Sequence[Factor], squared: Floats) -> Residuals:
    """Return the residuals of factors, given the squared Mahalanobis distance (n,) of each."""
    kinds = list(_KINDS)
    row_of_kind = {kind: row for row, kind in enumerate(kinds)}
    rows = np.array([row_of_kind[factor.kind] for factor in factors], dtype=np.int64)
    names, dofs = [name for name, _ in _KINDS.values()], np.array([dof for _, dof in _KINDS.values()])
    alone = np.array([kind in PRIOR_KINDS or kind in PIN_KINDS for kind in kinds])
    scales = np.array([CAUCHY_SCALES.get(kind, np.inf) for kind in kinds])
    first = np.array([factor.first for factor in factors], dtype=np.int64)
    second = np.array([factor.second for factor in factors], dtype=np.int64)
    return Residuals(
        kind=tuple(names[row] for row in rows.tolist()),
        between=np.column_stack([first, np.where(alone[rows], -1, second)]),
        squared=squared,
        dof=dofs[rows],
        weight=1.0 / (1.0 + squared / scales[rows] ** 2),
    )
