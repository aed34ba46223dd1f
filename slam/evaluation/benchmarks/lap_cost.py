"""Measure time per scan and memory over repeated laps of one tour: both must stay bounded."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.messages import Scan
from drivers.simulation import Simulation

from ...config import Config
from ...pipeline import Slam
from ...warmup import warm_up


@dataclass(frozen=True, slots=True)
class LapCost:
    """Cost of one lap.

    number      of the lap, from 1
    median, p99  processor time per scan, milliseconds
    memory      of the process at the end of the lap, megabytes; NaN if the system does not report it
    keyframes, factors, walls  sizes of graph and map at the end of the lap
    """

    number: int
    median: float
    p99: float
    memory: float
    keyframes: int
    factors: int
    walls: int


def measure_laps(world: str, laps: int, config: Config, *, seed: int) -> Iterator[LapCost]:
    """Simulate `laps` laps of a world's path and yield the cost of each."""
    warm_up()
    lap_duration = Simulation(world, seed=seed).trajectory.duration
    slam = Slam(config)
    times: list[float] = []
    start: float | None = None
    number = 1
    for message in Simulation(world, seed=seed, duration=laps * lap_duration):
        start = message.stamp if start is None else start
        if message.stamp - start >= number * lap_duration:
            yield _lap_cost(number, times, slam)
            number, times = number + 1, []
        before = time.process_time()
        slam.add(message)
        if isinstance(message, Scan):
            times.append(1e3 * (time.process_time() - before))
        else:  # odometry triggers the processing of the waiting scan
            times[-1:] = [sum(times[-1:]) + 1e3 * (time.process_time() - before)]
    yield _lap_cost(number, times, slam)


def _lap_cost(number: int, times: list[float], slam: Slam) -> LapCost:
    mapper = slam.slam_state.mapper
    return LapCost(
        number=number,
        median=float(np.median(times)),
        p99=float(np.percentile(times, 99)),
        memory=_memory(),
        keyframes=mapper.keyframe_count,
        factors=mapper.graph.factor_count,
        walls=len(mapper.landmarks.walls),
    )


def _memory() -> float:
    """Return the current memory of the process, megabytes; NaN if the system does not report it."""
    if sys.platform != "linux":
        return float("nan")
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6
