"""Odometry past familiar places: motions that start at a keyframe of an earlier pass, and scans placed relative to one.

In a familiar place no keyframes are added, and scans are placed relative to old ones. If the pass was matched with the
wrong place, odometry has to lead from the keyframe before instead.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from drivers import se2

from ...estimation.refinement import ScanHistory
from ...graph.factors import Factor, FactorKind
from ...odometry.error_model import OdometryModel


def is_detour(factor: Factor, keyframes: range) -> bool:
    """Return True if a factor is odometry's motion to one of the keyframes of a pass from a keyframe before them."""
    later = factor.second in keyframes and factor.second != keyframes.start
    return factor.kind is FactorKind.ODOMETRY and later and factor.first < keyframes.start


def direct_motions(
    factors: Iterable[Factor], history: ScanHistory, model: OdometryModel, keyframes: range
) -> list[Factor]:
    """Return odometry's motions from the keyframe before that take the place of the detours of a pass."""
    motions, trusted = [], np.zeros(len(history), dtype=bool)
    for keyframe in sorted(factor.second for factor in factors if is_detour(factor, keyframes)):
        row, to = history.keyframes[keyframe - 1 : keyframe + 1].tolist()
        motion, covariance = history.motion(row, to, model, trusted)
        motions.append(Factor(FactorKind.ODOMETRY, keyframe - 1, keyframe, motion, covariance))
    return motions


def without_detours(history: ScanHistory, keyframes: range) -> ScanHistory:
    """Return a history in which the scans of a pass are relative to its own keyframes, by odometry if they were not."""
    own, relative, informations = history.own_keyframes.copy(), history.relative.copy(), history.informations.copy()
    before = np.searchsorted(history.keyframes, np.arange(len(history)), side="right") - 1
    for row in np.flatnonzero(np.isin(before, keyframes) & (own < keyframes.start)).tolist():
        start = history.scans[int(history.keyframes[before[row]])]
        own[row], informations[row] = before[row], 0.0
        relative[row] = se2.between(start.odometry, history.scans[row].odometry)
    return replace(history, own_keyframes=own, relative=relative, informations=informations)
