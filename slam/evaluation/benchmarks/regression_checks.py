"""Check a small part of the benchmarks against limits, to detect regressions (`wclm bench gate`).

Accuracies have fixed seeds and do not depend on time. Times are relative to a reference computation timed along with
them (see `reference_work` and `features.benchmark.timing`), so that they are comparable between machines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from features.benchmark.accuracy import COARSE, FINE, METHODS, Level, measure
from features.benchmark.timing import relative

from .slam_runs import QUICK_WORLDS, RunSpec, run_once

CHECKED_SCANS = 100
"""Per noise level."""
SEEDS = (0, 1, 2)
REPEATS, MAX_REPEATS = 4, 16
"""Of a timed run. All are identical, and the best counts: other programs slow down some runs more than the reference
timed during them. A run that exceeds its limit is repeated more often. A slower program remains slow."""
SECONDS = 20.0
"""Duration of each run."""
LEVELS = {"fine": Level(0.01, FINE, 0.0), "coarse": Level(0.05, COARSE, 0.0), "outliers": Level(0.01, FINE, 0.01)}


@dataclass(frozen=True, slots=True)
class Check:
    """A measured value and its limit: an upper limit, or a lower one if `floor`."""

    name: str
    value: float
    limit: float
    floor: bool = False

    @property
    def passed(self) -> bool:
        """True if the value keeps the limit."""
        return self.value >= self.limit if self.floor else self.value <= self.limit


CORNER_RECALL = {"fine": 0.994, "coarse": 0.935, "outliers": 0.98}
"""Of a hundred scans, which scatter by 0.01; the full benchmark has 1.000, 0.958 and 0.995."""
CORNER_NEES = 2.4
CORNERS_PER_CURVE = 0.1
"""At 1 cm of noise; 0.04 in the full benchmark, above 1 without detection of curves."""
EXTRACTION_TIME = 0.75
"""For a scan of 920 beams, relative to the reference; measured 0.55 and, with the same code, 0.68 on two processors."""
RUN_LIMITS = {"office": (0.002, 1.95), "room": (0.0015, 1.45)}
"""Error in metres (mean over the seeds), and time per scan relative to the reference. Measured 0.0013 and 1.63, 0.0008
and 1.18, with nothing else on the machine; 1.46 to 1.54 and 1.11 to 1.13 beside three programs that compute or read
memory all the time."""


def run_checks() -> Iterator[Check]:
    """Yield all checks, the quickest first."""
    yield Check("extraction / reference, 920 beams", relative()[0], EXTRACTION_TIME)
    for name, level in LEVELS.items():
        row = next(measure(scans=CHECKED_SCANS, levels=[level], methods=METHODS[:1]))
        yield Check(f"corner recall, {name}", row.corner_recall, CORNER_RECALL[name], floor=True)
        yield Check(f"corner NEES, {name}", row.corner_nees, CORNER_NEES)
    curved = next(measure(scans=CHECKED_SCANS, levels=[LEVELS["fine"]], methods=METHODS[:1], curved=True))
    yield Check("false corners per curve", curved.curved_corners, CORNERS_PER_CURVE)
    for world in QUICK_WORLDS:
        errors = [run_once(RunSpec(world, seed=seed, seconds=SECONDS)).error for seed in SEEDS]
        error, time = RUN_LIMITS[world]
        yield Check(f"path error, {world}, m", float(np.mean(errors)), error)
        yield Check(f"scan / reference, {world}", time_by_reference(RunSpec(world, seconds=SECONDS), time), time)


def time_by_reference(spec: RunSpec, limit: float) -> float:
    """Return the time per scan relative to the reference timed during the same run: the least of identical runs.

    There are `REPEATS` runs, and up to `MAX_REPEATS` until the result keeps the limit.
    """
    value = np.inf
    for count in range(1, MAX_REPEATS + 1):
        value = min(value, run_once(spec).by_reference)
        if count >= REPEATS and value <= limit:
            break
    return value


def format_checks(checks: list[Check]) -> Iterator[str]:
    """Yield a line for each check."""
    for check in checks:
        bound = "at least" if check.floor else "at most"
        verdict = "" if check.passed else "  REGRESSION"
        yield f"{check.name:<36} {check.value:9.4f}  {bound} {check.limit:g}{verdict}"
