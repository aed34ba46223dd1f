"""A scan divided into walls: split, merge, refine, drop what is spurious, bridge it.

A run of rays between certain breaks is split where the costs of the two parts add up to the least, as long as that
gains more than a penalty; neighbours whose common line costs less than the penalty are merged again. Boundaries are
then moved to where both sides fit best, pieces of very few rays are dropped, and walls that only those interrupted
are joined.
"""

from __future__ import annotations

from .compiled import compiled
from .merging import drop_small, extend, merge
from .pieces import Pieces
from .rays import Rays
from .settings import Settings
from .splitting import refine, split
from .types import Floats, Integers

PENALTY = 30.0
"""Gain of chi-square that a further break must bring. A break adds two line parameters and a position to choose among
n: about 3 ln n, half as much again against the break that noise likes best."""


@compiled
def segment(
    rays: Rays, count: int, step: float, pieces: Pieces, gains: Floats, stack: Integers, settings: Settings
) -> int:
    """Divide the rays of a scan into walls; their number. What belongs to no wall is in no piece."""
    made = split(rays, count, settings.penalty, pieces, gains, stack)
    made = merge(rays, count, step, pieces, made, False, settings)
    refine(rays, count, pieces, made, gains)
    solid = drop_small(pieces, made)
    if solid < made:
        extend(rays, count, pieces, solid, settings)
        solid = merge(rays, count, step, pieces, solid, True, settings)
        refine(rays, count, pieces, solid, gains)
    return solid
