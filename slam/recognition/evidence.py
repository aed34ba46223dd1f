"""Evidence for a placement of a map in another one, in nats, from how well the cells of both maps fit.

It is the logarithm of a likelihood ratio: to a place that only looks alike. There a cell fits with the chance that is
counted at all other placements that were tried, where the mean of all cells counts as two more. So a bare wall that
lies on a wall at every placement is no evidence, nor is a door among equal doors.

Equations, whose symbols the code uses: docs/mathematics.md#unknown-start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from .placements import Placement
from .scanned_map import ScannedDrive, ScannedMap

# Points in seen space that a cell needs: half a metre of wall. Origin: definition.
MIN_CELL_POINTS = 5
# Probabilities that a cell is as it was, equally likely before: more than half of a building stays.
# Origin: chosen; not measured.
UNCHANGED_PROBABILITIES = np.linspace(0.5, 0.995, 100)
# Probability that a cell fits that is as it was, and the largest one that a cell fits anywhere.
# Origin: chosen, for points that are noise; not measured.
MAX_FIT = 0.995
# Placements that the mean fit of all cells counts as, for each cell. Origin: definition, as in Laplace's rule.
PRIOR_COUNT = 2.0
# Values of b, from almost no cell that fits to a place that looks as much alike as the others. Origin: numerical.
ALIKE_OFFSETS = np.linspace(-6.0, 0.0, 61)


@dataclass(frozen=True, slots=True, eq=False)
class CellFits:
    """Fit (n,) of the cells of both maps, 0 to 1, and which of them are `known` (n,): in space that was seen."""

    fit: Floats
    known: NDArray[np.bool_]


def compare_cells(new: ScannedDrive, old: ScannedMap, placement: Placement) -> CellFits:
    """Compare the submaps of a drive with a map: cells of the drive in the map, then the reverse."""
    misfits, known = np.zeros(new.cells), np.zeros(new.cells)
    old_misfits, old_known = np.zeros(old.cells), np.zeros(old.cells)
    for submap, pose in zip(new.submaps, placement.poses, strict=True):
        submap.points.add_misfits(old.field, pose, misfits, known)
        near = old.points.near(pose[:2], submap.scan.reach)
        near.add_misfits(submap.scan.field, se2.inverse(pose), old_misfits, old_known)
    misfits, known = np.concatenate([misfits, old_misfits]), np.concatenate([known, old_known])
    return CellFits(1.0 - misfits / np.maximum(known, 1.0), known >= MIN_CELL_POINTS)


def chances_of_fit(placements: Sequence[CellFits]) -> Floats:
    """Return (k, n) the probability that a cell fits where it only looks alike, for each of k placements."""
    known = np.array([fits.known for fits in placements], dtype=np.float64)
    fit = known * np.array([fits.fit for fits in placements])
    others, fitting = known.sum() - known.sum(axis=1), fit.sum() - fit.sum(axis=1)
    mean = ((fitting + 1.0) / (others + 2.0))[:, None]  # with Laplace's rule of succession
    return np.asarray((fit.sum(axis=0) - fit + PRIOR_COUNT * mean) / (known.sum(axis=0) - known + PRIOR_COUNT))


def evidence_of(fits: CellFits, chance: Floats) -> float:
    """Return the evidence (nats) of the known cells, given the `chance` (n,) of each cell to fit."""
    fit, chance = fits.fit[fits.known], chance[fits.known]
    unchanged = UNCHANGED_PROBABILITIES[:, None]
    right = _log_likelihoods(fit, _logit(unchanged * MAX_FIT + (1.0 - unchanged) * chance))
    alike = _log_likelihoods(fit, _logit(chance) + ALIKE_OFFSETS[:, None])
    return float(np.log(np.mean(np.exp(right - right.max()))) + right.max() - alike.max())


def _logit(probability: Floats) -> Floats:
    return np.asarray(np.log(probability / (1.0 - probability)))


def _log_likelihoods(fit: Floats, logits: Floats) -> Floats:
    """Return (k,) the log-likelihoods of cells that fit with `fit` (n,), for `logits` (k, n) of their probabilities."""
    return np.asarray((fit * logits - np.logaddexp(0.0, logits)).sum(axis=1))
