r"""Evidence for a placement of a map in another one, in nats, from how well the cells of both maps fit.

A cell fits with a share $q$ of its points, those in space that the other map has seen; cells in unseen space are no
evidence. Let $h$ be the probability that something is still there if the placement is right, and $c_u$ that the cell u
fits at a place that only looks alike. The evidence is the logarithm of the likelihood ratio,

    log mean_h prod_u h^q_u (1 - h)^(1 - q_u)  -  max_{b <= 0} log prod_u c_u(b)^q_u (1 - c_u(b))^(1 - q_u),

with $\operatorname{logit} c_u(b) = \operatorname{logit} c_u + b$: a place may look less alike than others, not more.
$c_u$ is the share with which the cell fits at all other placements that were found, with Laplace's rule of succession.
So a bare wall that lies on a wall at every placement is no evidence, nor is a door among equal doors.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats
from .placements import Placement
from .scanned_map import ScannedMap

MIN_CELL_POINTS = 5
"""Points in seen space that a cell needs: half a metre of wall."""
HIT_PROBABILITIES = np.linspace(0.5, 0.995, 100)
"""Probabilities that a cell fits at the right placement, equally likely before: more than half of a building stays."""
ALIKE_OFFSETS = np.linspace(-6.0, 0.0, 61)
"""Values of b, from almost no cell that fits to a place that looks as much alike as the others."""


@dataclass(frozen=True, slots=True, eq=False)
class CellFits:
    """Fit (n,) of the cells of both maps, 0 to 1, and which of them are `known` (n,): in space that was seen."""

    fit: Floats
    known: NDArray[np.bool_]

    @property
    def share(self) -> float:
        """Mean fit of the known cells, by Laplace's rule of succession."""
        return float((self.fit[self.known].sum() + 1.0) / (self.known.sum() + 2.0))


def compare_cells(new: ScannedMap, old: ScannedMap, placement: Placement, submaps: Iterable[int]) -> CellFits:
    """Compare some submaps of a map with the other one: cells of the new map in the old one, then the reverse."""
    misfits, known = np.zeros(new.cells), np.zeros(new.cells)
    old_misfits, old_known = np.zeros(old.cells), np.zeros(old.cells)
    for row in submaps:
        submap, pose = new.submaps[row], placement.poses[row]
        submap.points.add_misfits(old.field, pose, misfits, known)
        near = old.points.near(pose[:2], submap.reach)
        near.add_misfits(submap.field, se2.inverse(pose), old_misfits, old_known)
    misfits, known = np.concatenate([misfits, old_misfits]), np.concatenate([known, old_known])
    return CellFits(1.0 - misfits / np.maximum(known, 1.0), known >= MIN_CELL_POINTS)


def chance_of_fit(others: Sequence[CellFits]) -> Floats:
    """Return (n,) the probability that each cell fits at a place that looks alike, from placements there."""
    known = np.array([fits.known for fits in others])
    fit = np.array([fits.fit for fits in others])
    return np.asarray(((known * fit).sum(axis=0) + 1.0) / (known.sum(axis=0) + 2.0))


def evidence_of(fits: CellFits, chance: Floats, hit_probabilities: Floats = HIT_PROBABILITIES) -> float:
    """Return the evidence (nats) of the known cells, given the `chance` (n,) of each cell to fit; see the module."""
    fit, logit = fits.fit[fits.known], np.log(chance[fits.known] / (1.0 - chance[fits.known]))
    right = _log_likelihoods(fit, np.log(hit_probabilities / (1.0 - hit_probabilities))[:, None])
    alike = _log_likelihoods(fit, logit + ALIKE_OFFSETS[:, None])
    return float(np.log(np.mean(np.exp(right - right.max()))) + right.max() - alike.max())


def _log_likelihoods(fit: Floats, logits: Floats) -> Floats:
    """Return (k,) the log-likelihoods of cells that fit with `fit` (n,), for `logits` (k, n) of their probabilities."""
    return np.asarray((fit * logits - np.logaddexp(0.0, logits)).sum(axis=1))
