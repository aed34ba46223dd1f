"""Links between keyframes by what their scans show: common walls, and matches of their points."""

from __future__ import annotations

import numpy as np

from ..geometry.segments import Floats, Integers
from ..localisation.local_field import REFERENCE_DISTANCE
from ..mapping.mapper import Mapper


class ScanLinks:
    """Walls that the keyframes of a finished map observe, and matches between keyframes."""

    def __init__(self, mapper: Mapper) -> None:
        self._travelled: Floats = np.array(mapper.travelled)
        self._observations: Integers = np.array(mapper.graph.wall_observations(), dtype=np.int64).reshape(-1, 2)
        matches = [(factor.first, factor.second) for factor in mapper.graph.matches()]
        self._matches: Integers = np.sort(np.array(matches, dtype=np.int64).reshape(-1, 2), axis=1)  # the earlier first

    def connect(self, before: int, after: int) -> bool:
        """Return True if a scan shortly after a stretch shows what one shortly before it showed.

        before, after  keyframes at the ends of the stretch; those within REFERENCE_DISTANCE of them along the drive
                       see mostly the same
        """
        start, end = self._travelled[before] - REFERENCE_DISTANCE, self._travelled[after] + REFERENCE_DISTANCE
        first, last = np.searchsorted(self._travelled, start), np.searchsorted(self._travelled, end, side="right") - 1
        earlier, later = self._matches.T
        if ((first <= earlier) & (earlier <= before) & (after <= later) & (later <= last)).any():
            return True
        keyframes, walls = self._observations.T
        seen_before = walls[(first <= keyframes) & (keyframes <= before)]
        seen_after = walls[(after <= keyframes) & (keyframes <= last)]
        return bool(np.isin(seen_before, seen_after).any())
