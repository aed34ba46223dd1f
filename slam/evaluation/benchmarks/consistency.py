"""Test the consistency of covariances over many simulated drives with independent noise.

Each drive has its own sensor noise and its own wheel errors. The lidar is mounted off the base's centre and turned, to
reveal errors that a centred lidar looking ahead would hide.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.simulation import LidarModel, Simulation

from ...config import Config, LidarConfig
from ...geometry.segments import Floats
from ...offline.calibration.range_bias import estimate_range_bias
from ..ground_truth import Nees, measure
from ..nees import Consistency, run_consistency

MOUNT = (0.2, -0.15, math.radians(100.0))  # x, y, heading of the lidar on the base: metres, metres, radians
CALIBRATION_SEED = 1_000_000  # of the calibration drive; the others count from 0
DURATION = 60.0  # seconds: 27 m travelled and 490 degrees turned in the office


@dataclass(frozen=True, slots=True)
class ConsistencyRow:
    """Consistency of one kind of estimate."""

    name: str
    consistency: Consistency


def simulate(
    seeds: Iterable[int],
    duration: float = DURATION,
    world: str = "office",
    *,
    range_bias: float = 0.0,
    config: Config | None = None,
) -> Iterator[Nees]:
    """Yield the NEES of one simulated drive per seed.

    `duration` is in seconds; `range_bias` is added to all ranges, metres.
    """
    lidar = LidarModel(range_bias=range_bias)
    for seed in seeds:
        yield measure(Simulation(world, seed=seed, duration=duration, lidar=lidar, mount=MOUNT), config)[0]


def calibrated_config(range_bias: float, duration: float = DURATION, world: str = "office") -> tuple[Config, float]:
    """Return a configuration with the range bias estimated from a separate drive, and its standard error."""
    drive = Simulation(
        world, seed=CALIBRATION_SEED, duration=duration, lidar=LidarModel(range_bias=range_bias), mount=MOUNT
    )
    bias, sigma = estimate_range_bias(list(drive), Config())
    return Config(lidar=LidarConfig(range_bias=bias)), sigma


def summarise(runs: Sequence[Nees]) -> list[ConsistencyRow]:
    """Return the consistency of all poses, of each run's last pose, of walls and of corners.

    Raises MapError without runs.
    """

    def row(name: str, values: Sequence[Floats], dimensions: int) -> ConsistencyRow:
        return ConsistencyRow(name, run_consistency(values, dimensions))

    return [
        row("poses", [run.poses for run in runs], 3),
        row("last pose", [run.poses[-1:] for run in runs], 3),
        row("walls", [run.walls for run in runs], 2),
        row("corners", [run.corners for run in runs], 2),
    ]


def consistency_table(rows: Sequence[ConsistencyRow]) -> list[str]:
    """Return the lines of a table; all figures are per degree of freedom, so that 1 is consistent."""
    lines = ["NEES per dimension   mean  std. error  95 % band      runs"]
    for row in rows:
        found = row.consistency
        mean, error, low, high = np.array([found.mean, found.standard_error, found.low, found.high]) / found.dimensions
        verdict = "" if found.consistent else "  too cautious" if mean < low else "  overconfident"
        lines.append(f"{row.name:<18} {mean:6.2f}  {error:10.2f}  {low:.2f} to {high:.2f}  {found.count:4d}{verdict}")
    return lines
