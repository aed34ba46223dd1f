"""Whether cost is bounded: the same tour again and again must not cost more and more time or memory."""

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
class Lap:
    """One lap: the milliseconds of processor that a scan took (median, 99th percentile), the process's memory at its
    end (megabytes, NaN where the system does not tell), and the sizes of graph and map by then."""

    number: int
    median: float
    p99: float
    memory: float
    keyframes: int
    factors: int
    walls: int


def run(world: str, laps: int, config: Config, *, seed: int = 0) -> Iterator[Lap]:
    """Drive a world's path `laps` times and measure each."""
    warm_up()
    lap = Simulation(world, seed=seed).trajectory.duration
    slam = Slam(config)
    times: list[float] = []
    start: float | None = None
    number = 1
    for message in Simulation(world, seed=seed, duration=laps * lap):
        start = message.stamp if start is None else start
        if message.stamp - start >= number * lap:
            yield _measured(number, times, slam)
            number, times = number + 1, []
        before = time.process_time()
        slam.add(message)
        if isinstance(message, Scan):
            times.append(1e3 * (time.process_time() - before))
        else:  # odometry sets off the scan that waits for it
            times[-1:] = [sum(times[-1:]) + 1e3 * (time.process_time() - before)]
    yield _measured(number, times, slam)


def _measured(number: int, times: list[float], slam: Slam) -> Lap:
    mapper = slam.slam_state.mapper
    return Lap(
        number=number,
        median=float(np.median(times)),
        p99=float(np.percentile(times, 99)),
        memory=_memory(),
        keyframes=mapper.keyframe_count,
        factors=mapper.graph.factor_count,
        walls=len(mapper.landmarks.walls),
    )


def _memory() -> float:
    """Megabytes that the process holds now; NaN where the system does not tell."""
    if sys.platform != "linux":
        return float("nan")
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6
