"""Measure the time of each stage of processing a scan."""

from __future__ import annotations

import time


class StageTimer:
    """Milliseconds by stage of processing one scan."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """End a stage: it took the time since the previous stage ended."""
        now = time.perf_counter()
        self.laps[stage] = 1e3 * (now - self._last)
        self._last = now

    @property
    def total(self) -> float:
        """Milliseconds of all stages."""
        return sum(self.laps.values())
