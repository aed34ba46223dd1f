"""Groups of neighbouring rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.segments import Integers

# Scans or keyframes without a finding that may lie between two findings of one interval, and that may be findings by
# chance. Origin: chosen, about a metre.
MAX_GAP = 3


def consecutive_groups(rows: Integers, gap: int) -> list[NDArray[np.int64]]:
    """Split increasing row numbers into groups whose neighbours differ by at most `gap`."""
    return [group for group in np.split(rows, np.flatnonzero(np.diff(rows) > gap) + 1) if len(group)]
