"""Evidence for a placement of a map in another one, in nats, from how well the cells of both maps fit.

It is the logarithm of a likelihood ratio: to a place that only looks alike. There a cell fits with the chance that is
counted at all other placements that were tried, where the mean of all cells counts as two more. So a bare wall that
lies on a wall at every placement is no evidence, nor is a door among equal doors. Long walls change more rarely than
other things, so furniture that was moved together does not outweigh walls that do not fit.

A surface that fits is a cell of both maps, so it counts twice. An object that was moved counts twice as well, as it is
missing at one place and new at another. Of two walls that do not coincide, the nearer one hides the other: only one
cell does not fit, so it is counted twice.

Equations, whose symbols the code uses: docs/mathematics.md#unknown-start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats
from ..geometry.significance import MOST
from .placements import Placement
from .scanned_map import ScannedDrive, ScannedMap, are_on_walls

# Points in seen space that a cell needs: half a metre of wall. Origin: definition.
MIN_CELL_POINTS = 5
# Probability that an unchanged cell fits, and upper bound of the probability that a cell fits anywhere.
# Origin: chosen, for points that are noise; not measured.
MAX_FIT = 0.995
# Probabilities that a cell on no long wall is unchanged, all equally likely before: most of the cells are.
# Origin: definition; at the closures of Intel and fhw 66 and 72 % fit.
UNCHANGED_PROBABILITIES = np.linspace(MOST, MAX_FIT, 100)
# Probability that a cell of a long wall has changed, relative to that of another cell. Origin: chosen, as walls change
# by their doors only; at these closures 2 and 7 % did not fit, and 34 and 28 % of the others.
WALL_CHANGE_RATIO = 0.2
# Placements that the mean fit of all cells counts as, for each cell. Origin: definition, as in Laplace's rule.
PRIOR_COUNT = 2.0
# Values of b, from almost no cell that fits to a place that looks as much alike as the others. Origin: numerical.
ALIKE_OFFSETS = np.linspace(-6.0, 0.0, 61)


@immutable
class CellFits:
    """Fit (n,) of the cells of both maps, 0 to 1.

    known    (n,) true if they are in space that was seen
    on_wall  (n,) true if they are on long walls
    """

    fit: Floats
    known: NDArray[np.bool_]
    on_wall: NDArray[np.bool_]


def compare_cells(new: ScannedDrive, old: ScannedMap, placement: Placement) -> CellFits:
    """Compare the submaps of a drive with a map: cells of the drive in the map, then the reverse."""
    misfits, known = np.zeros(new.cells), np.zeros(new.cells)
    old_misfits, old_known = np.zeros(old.cells), np.zeros(old.cells)
    for submap, pose in zip(new.submaps, placement.poses, strict=True):
        submap.points.add_misfits(old, pose, misfits, known)
        near = old.points.near(pose[:2], submap.scan.reach)
        near.add_misfits(submap.scan, se2.inverse(pose), old_misfits, old_known)
    misfits, known = np.concatenate([misfits, old_misfits]), np.concatenate([known, old_known])
    on_wall = np.concatenate([are_on_walls(new.cells), are_on_walls(old.cells)])
    return CellFits(1.0 - misfits / np.maximum(known, 1.0), known >= MIN_CELL_POINTS, on_wall)


def chances_of_fit(placements: Sequence[CellFits]) -> Floats:
    """Return (k, n) the probability that a cell fits where it only looks alike, for each of k placements."""
    known = np.array([fits.known for fits in placements], dtype=np.float64)
    fit = known * np.array([fits.fit for fits in placements])
    others, fitting = known.sum() - known.sum(axis=1), fit.sum() - fit.sum(axis=1)
    mean = ((fitting + 1.0) / (others + 2.0))[:, None]  # with Laplace's rule of succession
    return np.asarray((fit.sum(axis=0) - fit + PRIOR_COUNT * mean) / (known.sum(axis=0) - known + PRIOR_COUNT))


def evidence_of(fits: CellFits, chance: Floats) -> float:
    """Return the evidence (nats) of the known cells, given the `chance` (n,) of each cell to fit."""
    fit, chance, on_wall = fits.fit[fits.known], chance[fits.known], fits.on_wall[fits.known]
    changed = (1.0 - UNCHANGED_PROBABILITIES[:, None]) * np.where(on_wall, WALL_CHANGE_RATIO, 1.0)
    missing = (1.0 - fit) * np.where(on_wall, 2.0, 1.0)
    right = _log_likelihoods(fit, missing, _logit((1.0 - changed) * MAX_FIT + changed * chance))
    alike = _log_likelihoods(fit, missing, _logit(chance) + ALIKE_OFFSETS[:, None])
    return float(np.log(np.mean(np.exp(right - right.max()))) + right.max() - alike.max())


def _logit(probability: Floats) -> Floats:
    return np.asarray(np.log(probability / (1.0 - probability)))


def _log_likelihoods(fitting: Floats, missing: Floats, logits: Floats) -> Floats:
    """Return (k,) the log-likelihoods of shares (n,) of cells that fit and that do not, for `logits` (k, n) to fit."""
    return np.asarray(-(fitting * np.logaddexp(0.0, -logits) + missing * np.logaddexp(0.0, logits)).sum(axis=1))
