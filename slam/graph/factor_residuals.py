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
    kinds = [_KINDS[factor.kind] for factor in factors]
    single = [factor.kind in PRIOR_KINDS or factor.kind in PIN_KINDS for factor in factors]
    ends = [(f.first, -1 if alone else f.second) for f, alone in zip(factors, single, strict=True)]
    scales = np.array([CAUCHY_SCALES.get(factor.kind, np.inf) for factor in factors])
    return Residuals(
        kind=tuple(kind for kind, _ in kinds),
        between=np.array(ends, dtype=np.int64).reshape(-1, 2),
        squared=squared,
        dof=np.array([dof for _, dof in kinds], dtype=np.int64),
        weight=1.0 / (1.0 + squared / scales**2),
    )
