"""Variables of the last factors, which iSAM2 eliminates last."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import chain, islice

import gtsam

from .factors import Factor, keys_of

# Number of the last factors whose variables are eliminated late. Origin: measured, on two recordings with some 50 new
# factors at each update: of 200, 250, 300, 400 and 600, 200 and 400 take the least time on one, an eighth less than a
# single group with 200, and 400 on the other.
RECENT_FACTORS = 400


class RecentVariables:
    """Variables of the last factors.

    An update eliminates the variables of the new factors again, and all that were eliminated after these. What was
    observed in the last metres will be observed again, so that it should come after everything else.
    """

    def __init__(self) -> None:
        self._keys: deque[tuple[int, int]] | None = None  # of the last factors; None if not known any more

    def copy(self) -> RecentVariables:
        """Return an independent copy."""
        other = RecentVariables()
        other._keys = None if self._keys is None else self._keys.copy()
        return other

    def forget(self) -> None:
        """Forget the last factors, as some were removed; they are read from the graph again."""
        self._keys = None

    def groups_with(self, new: Sequence[Factor], factors: dict[int, Factor]) -> gtsam.KeyGroupMap:
        """Return the variables of the last factors and of new ones, as the order of elimination that GTSAM takes.

        factors  of the graph before the new ones, in the order in which they were added

        The variables of the new factors come last, as their joint covariance is read back.
        """
        if self._keys is None:
            known = islice(reversed(factors.values()), RECENT_FACTORS)
            self._keys = deque(reversed([keys_of(factor) for factor in known]), RECENT_FACTORS)
        self._keys.extend(keys := [keys_of(factor) for factor in new])
        newest = set(chain.from_iterable(keys))
        last = 2 if len(newest) > 2 else 1  # there must be fewer groups than variables to be eliminated
        groups = gtsam.KeyGroupMap()
        for key in newest.union(chain.from_iterable(self._keys)):
            groups.insert2(key, last if key in newest else 1)
        return groups
