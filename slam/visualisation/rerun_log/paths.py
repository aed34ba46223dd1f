"""Paths that only grow, in blocks: a long path logged anew with every keyframe would fill the file."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...geometry.segments import Floats

BLOCK = 128  # points; a block is logged again while it grows, and never after


class GrowingPath:
    """Points (x, y) in metres that never change; points closer than `spacing` to the last one are left out.

    Blocks that were given out and are full are forgotten.
    """

    def __init__(self, spacing: float) -> None:
        self._spacing = spacing
        self._number = 0  # of the first block that is kept
        self._blocks: list[list[tuple[float, float]]] = [[]]
        self._grown = False

    def append(self, x: float, y: float) -> None:
        """Add a point."""
        block = self._blocks[-1]
        if block and np.hypot(x - block[-1][0], y - block[-1][1]) < self._spacing:
            return
        if len(block) == BLOCK:
            block = [block[-1]]  # without a gap between the blocks
            self._blocks.append(block)
        block.append((x, y))
        self._grown = True

    def changed(self) -> Iterator[tuple[int, Floats]]:
        """The number and points (n, 2) of each block that grew since it was last given out here."""
        if not self._grown:
            return
        yield from [(self._number + place, np.array(block)) for place, block in enumerate(self._blocks)]
        self._number += len(self._blocks) - 1
        self._blocks, self._grown = self._blocks[-1:], False
