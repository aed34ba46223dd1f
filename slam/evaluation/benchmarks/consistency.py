"""Test the consistency of covariances over simulated drives with independent noise, under several conditions.

Each drive has its own sensor noise and its own wheel errors. Values of one drive are correlated, so each drive is one
draw: the mean of its NEES. The mean over drives is judged by its standard error from the scatter of these draws.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from drivers.simulation import LidarModel, Simulation

from ...config import Config, LidarConfig
from ...errors import MapError
from ...geometry.chi_square import chi_square_quantile
from ...geometry.segments import Floats
from ...io.json_files import to_json_types
from ...offline.calibration.range_bias import estimate_range_bias
from ..ground_truth import Nees, measure
from ..nees import GROSS, Consistency, run_consistency
from .consistency_conditions import CONDITIONS, MOUNT

NOMINAL = "nominal"
CALIBRATION_SEED = 1_000_000  # of the calibration drive; the others count from the first seed
DURATION = 60.0  # seconds: 27 m travelled and 490 degrees turned in the office
LOW, HIGH = 0.7, 1.4
"""NEES per dimension within which covariances are called consistent: standard deviations are 16 % too small at most and
20 % too large. Simulated noise is as modelled at best, so a narrower band would promise more than can be kept."""
CLEARLY = 2.0
"""Standard errors by which a mean must lie outside this band to be called inconsistent."""


@dataclass(frozen=True, slots=True)
class ConsistencyRow:
    """Consistency of one kind of estimate; figures are per dimension.

    gross  share of all values beyond the quantile GROSS of the chi-square distribution
    count  number of values
    """

    name: str
    consistency: Consistency
    gross: float
    count: int

    @property
    def mean(self) -> float:
        """Mean NEES."""
        return self.consistency.mean / self.consistency.dimensions

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, from the scatter of the drives' means; NaN for one drive."""
        return self.consistency.standard_error / self.consistency.dimensions

    @property
    def inside(self) -> bool:
        """True if the mean is between LOW and HIGH."""
        return LOW <= self.mean <= HIGH

    @property
    def verdict(self) -> str:
        """Return "inside", "overconfident", "too cautious", or "undecided" if it is outside by few standard errors."""
        if self.inside:
            return "inside"
        margin = CLEARLY * self.standard_error
        if self.mean - margin > HIGH:
            return "overconfident"
        return "too cautious" if self.mean + margin < LOW else "undecided"


@dataclass(frozen=True, slots=True)
class ConditionResult:
    """Result of all drives under one condition; `failed` ones have no map. Without a map there are no rows."""

    condition: str
    drives: int
    failed: int
    rows: tuple[ConsistencyRow, ...]

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        estimates = {
            row.name: {
                "mean": row.mean,
                "standard_error": row.standard_error,
                "inside": row.inside,
                "verdict": row.verdict,
                "drives": row.consistency.count,
                "values": row.count,
                "gross": row.gross,
            }
            for row in self.rows
        }
        return {
            "condition": self.condition,
            "description": CONDITIONS[self.condition].description,
            "drives": self.drives,
            "failed": self.failed,
            "inside": bool(self.rows) and all(row.inside for row in self.rows),
            "nees": to_json_types(estimates),
        }


def simulate(
    seeds: Iterable[int],
    duration: float = DURATION,
    condition: str = NOMINAL,
    *,
    range_bias: float = 0.0,
    config: Config | None = None,
    processes: int = 1,
) -> Iterator[Nees | None]:
    """Yield the NEES of one simulated drive per seed, None for a drive that gives no map.

    `duration` is in seconds; `range_bias` is added to all ranges, metres.
    """
    run = partial(_simulate_once, duration=duration, condition=condition, range_bias=range_bias, config=config)
    if processes == 1:
        yield from map(run, seeds)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(run, seeds)


def _simulate_once(seed: int, duration: float, condition: str, range_bias: float, config: Config | None) -> Nees | None:
    chosen = CONDITIONS[condition]
    world, straight = chosen.building(seed)
    lidar = replace(chosen.lidar, range_bias=chosen.lidar.range_bias + range_bias)
    drive = Simulation(world, seed, duration, lidar, chosen.wheels, chosen.mount)
    messages = drive if chosen.log is None else chosen.log(drive, np.random.default_rng(seed))
    try:
        return measure(drive, config, messages=messages, straight=straight)[0]
    except MapError:
        return None


def calibrated_config(range_bias: float, duration: float = DURATION) -> tuple[Config, float]:
    """Return a configuration with the range bias estimated from a separate drive, and its standard error."""
    drive = Simulation(
        "office", seed=CALIBRATION_SEED, duration=duration, lidar=LidarModel(range_bias=range_bias), mount=MOUNT
    )
    bias, sigma = estimate_range_bias(list(drive), Config())
    return Config(lidar=LidarConfig(range_bias=bias)), sigma


def summarise(runs: Sequence[Nees | None], condition: str = NOMINAL) -> ConditionResult:
    """Return the consistency of poses, last poses, relative poses, walls and corners over the drives of a condition.

    Kinds of estimates that no drive has are left out.
    """
    maps = [run for run in runs if run is not None]
    kinds: list[tuple[str, list[Floats], int]] = [
        ("poses", [run.poses for run in maps], 3),
        ("last pose", [run.poses[-1:] for run in maps], 3),
        ("relative poses", [run.relative_poses for run in maps], 3),
        ("walls", [run.walls for run in maps], 2),
        ("corners", [run.corners for run in maps], 2),
    ]
    rows = tuple(_row(*kind) for kind in kinds if any(np.isfinite(values).any() for values in kind[1]))
    return ConditionResult(condition, len(runs), len(runs) - len(maps), rows)


def _row(name: str, values: list[Floats], dimensions: int) -> ConsistencyRow:
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    gross = float(np.mean(known > chi_square_quantile(GROSS, dimensions)))
    return ConsistencyRow(name, run_consistency(values, dimensions), gross, len(known))


def consistency_table(results: Sequence[ConditionResult]) -> list[str]:
    """Return the lines of a Markdown table: mean NEES per dimension, its standard error, and the verdict.

    One question mark stands beside a mean outside of LOW to HIGH, bold print is for those that are so clearly.
    """
    names = list(dict.fromkeys(row.name for result in results for row in result.rows))
    lines = [
        f"| NEES per dimension | {' | '.join(names)} | all in {LOW} to {HIGH} |",
        "|---" * (len(names) + 2) + "|",
    ]
    for result in results:
        rows = {row.name: row for row in result.rows}
        cells = [_cell(rows[name]) if name in rows else "-" for name in names]
        inside = "yes" if result.rows and all(row.inside for row in result.rows) else "no"
        failed = f", {result.failed} of {result.drives} drives without a map" if result.failed else ""
        label = f"{result.condition}: {CONDITIONS[result.condition].description}{failed}"
        lines.append(f"| {label} | {' | '.join(cells)} | {inside} |")
    return lines


def _cell(row: ConsistencyRow) -> str:
    error = "" if math.isnan(row.standard_error) else f" ± {row.standard_error:.2f}"
    text = f"{row.mean:.2f}{error}"
    if row.verdict == "inside":
        return text
    return f"{text} ?" if row.verdict == "undecided" else f"**{text}**"
