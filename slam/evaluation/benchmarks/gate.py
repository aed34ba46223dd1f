"""A small slice of the benchmarks against what it came to when last looked at: nothing may fall back unnoticed.

Accuracies have seeds and no clock. Times are in units of a reference that is timed along with them (see `drives` and
`features.benchmark.timing`), so that they can be compared between machines, and on a busy one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from features.benchmark.accuracy import COARSE, FINE, WAYS, Level, measure
from features.benchmark.timing import relative

from .drives import QUICK_WORLDS, Case, drive, follow

SCANS = 100
"""Of each level of noise."""
SEEDS = (0, 1, 2)
REPEATS = 4
"""Of a drive that is timed. It is the same each time, so the fastest time of each message counts: what others do with
the processor makes single messages slower, not the same ones again and again."""
SECONDS = 20.0
"""Of each drive."""
LEVELS = {"fine": Level(0.01, FINE, 0.0), "coarse": Level(0.05, COARSE, 0.0), "outliers": Level(0.01, FINE, 0.01)}


@dataclass(frozen=True, slots=True)
class Check:
    """What was measured and how far it may go: at most `limit`, or at least where `floor` is set."""

    name: str
    value: float
    limit: float
    floor: bool = False

    @property
    def passed(self) -> bool:
        """Whether it has not fallen back."""
        return self.value >= self.limit if self.floor else self.value <= self.limit


CORNER_RECALL = {"fine": 0.994, "coarse": 0.935, "outliers": 0.98}
"""Of a hundred scans; the full benchmark stands at 1.000, 0.958 and 0.995, and a hundred scans scatter by 0.01."""
CORNER_NEES = 2.4
FANS = 0.1
"""Corners for each curved thing at 1 cm; 0.04 in the full benchmark, above 1 where curves are not known."""
EXTRACTION = 0.6
"""Of the reference for a scan of 920 beams; it stands at 0.45."""
DRIVES = {"office": (0.002, 85.0), "room": (0.0015, 62.0)}
"""Metres (mean over the seeds) and times the reference for a scan; they stand at 0.0011 and 59, 0.0007 and 42.
Times scatter by a few per cent from run to run, and by a fifth with what else the machine does."""


def checks() -> Iterator[Check]:
    """All of them, the quickest first."""
    yield Check("a scan of 920 beams, by reference", relative()[0], EXTRACTION)
    for name, level in LEVELS.items():
        row = next(measure(scans=SCANS, levels=[level], ways=WAYS[:1]))
        yield Check(f"corners found, {name}", row.corner_recall, CORNER_RECALL[name], floor=True)
        yield Check(f"NEES of corners, {name}", row.corner_nees, CORNER_NEES)
    curved = next(measure(scans=SCANS, levels=[LEVELS["fine"]], ways=WAYS[:1], curved=True))
    yield Check("corners of curved things", curved.curved_corners, FANS)
    for world in QUICK_WORLDS:
        errors = [drive(Case(world, seed=seed, seconds=SECONDS)).error for seed in SEEDS]
        error, time = DRIVES[world]
        yield Check(f"error of the path, {world}, m", float(np.mean(errors)), error)
        yield Check(f"a scan, {world}, by reference", time_by_reference(Case(world, seconds=SECONDS)), time)


def time_by_reference(case: Case) -> float:
    """The time of a scan in units of the reference, the fastest of each taken over `REPEATS` equal drives."""
    results, watches = zip(*(follow(case) for _ in range(REPEATS)), strict=True)
    fastest = np.min([watch.laps for watch in watches], axis=0).sum() / results[0].scans
    return float(fastest / np.min([watch.references for watch in watches]))


def lines(found: list[Check]) -> Iterator[str]:
    """For people."""
    for check in found:
        bound = "at least" if check.floor else "at most"
        verdict = "" if check.passed else "  FELL BACK"
        yield f"{check.name:<36} {check.value:9.4f}  {bound} {check.limit:g}{verdict}"
