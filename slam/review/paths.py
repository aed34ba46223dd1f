"""Paths that only grow, in blocks: a long path logged anew with every keyframe would fill the file."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..segments import Floats

BLOCK = 128  # points; a block is logged again while it grows, and never after


class GrowingPath:
    """Points (x, y) in metres that never change; points closer than `spacing` to the last one are left out."""

    def __init__(self, spacing: float) -> None:
        self._spacing = spacing
        self._blocks: list[list[tuple[float, float]]] = [[]]
        self._unlogged = 0

    def append(self, x: float, y: float) -> None:
        """Add a point."""
        block = self._blocks[-1]
        if block and np.hypot(x - block[-1][0], y - block[-1][1]) < self._spacing:
            return
        if len(block) == BLOCK:
            block = [block[-1]]  # without a gap between the blocks
            self._blocks.append(block)
        block.append((x, y))
        self._unlogged = min(self._unlogged, len(self._blocks) - 1)

    def changed(self) -> Iterator[tuple[int, Floats]]:
        """The number and points (n, 2) of each block that grew since it was last given out here."""
        for number in range(self._unlogged, len(self._blocks)):
            if self._blocks[number]:
                yield number, np.array(self._blocks[number])
        self._unlogged = len(self._blocks)
