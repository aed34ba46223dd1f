"""The live grid of two hours of exploring: each update must be short, and memory proportional to the area."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers import se2
from drivers.ros2.encoder import NodeEncoder
from drivers.simulation import Simulation
from slam import Slam
from slam.events import Event, KeyframeAdded
from slam.io.exports import Occupancy
from slam.io.exports.live_grid import DRAWING_TIME, LiveGrid
from slam.io.host import resident_memory
from slam.ros.outputs import message_grid

from .live_run import Findings

DRIVE = 280.0
"""Seconds of one drive through the simulated office."""
OFFICE, COLUMNS = (27.0, 17.0), 6
"""Metres from one office to the next, along x and y, and offices along x."""
KEYFRAME_PERIOD = 0.6
"""Seconds from one keyframe to the next; updates follow them."""
CLOSURE, MOVED, MAX_SHIFT = 200, 1500, 0.3
"""Keyframes from one loop closure to the next, those that it moves, and metres by which it moves the last of them."""
MAX_UPDATE = 0.03
"""Seconds of processor time of an update, from drawing to the encoded message, in 99 % of cases."""
MAX_GROWTH = 1.5
"""Largest ratio of the memory per keyframe in the second half of the drive to that in the first."""


class _Keyframes:
    """Sink that collects keyframes: points in the base's frame, and pose."""

    handled = (KeyframeAdded,)

    def __init__(self) -> None:
        self.found: list[KeyframeAdded] = []

    def handle(self, event: Event) -> None:
        assert isinstance(event, KeyframeAdded)
        self.found.append(event)


class _SteppedGrid(LiveGrid):
    """Live grid without a thread."""

    def _run(self) -> None:
        return


def explore(folder: Path, seconds: int, source: random.Random) -> Iterator[Findings]:
    """Draw the keyframes of a drive through offices side by side, with loop closures; yield the times of updates."""
    keyframes = _Keyframes()
    slam = Slam(sinks=[keyframes])
    for message in Simulation("office", source.randrange(1000), DRIVE):
        slam.add(message)
    slam.finish()
    encoder, sizes, poses = NodeEncoder(), [0], np.zeros((0, 3))

    def publish(stamp: float, occupancy: Occupancy) -> None:
        sizes.append(len(encoder.grid(stamp, "map", message_grid(occupancy))))

    grid, times, memory = _SteppedGrid(0.05, 0.0, np.inf, publish), [], [resident_memory() or 0.0]
    offices = max(1, round(seconds / DRIVE))
    for number in range(offices):
        aside = np.array([OFFICE[0] * (number % COLUMNS), OFFICE[1] * (number // COLUMNS), 0.0])
        for keyframe in keyframes.found:
            pose = se2.compose(aside, keyframe.pose)
            poses = np.concatenate([poses, pose[None]])
            grid.add(float(len(poses)), keyframe.points, np.zeros((1, 2)), pose)
            if len(poses) % CLOSURE == 0:
                share = np.clip(1.0 - np.arange(len(poses))[::-1] / MOVED, 0.0, 1.0)
                poses[:, :2] += share[:, None] * np.array([source.uniform(-MAX_SHIFT, MAX_SHIFT), 0.0])
                grid.move(poses)
            for _ in range(max(1, int(KEYFRAME_PERIOD / (10.0 * DRAWING_TIME)))):  # a tenth of the time is for updates
                began = time.thread_time()
                finished = grid.update(DRAWING_TIME)
                times.append(time.thread_time() - began)
                if finished:
                    break
        memory.append(resident_memory() or 0.0)
    found = Findings({"keyframes": len(poses), "area": round(offices * OFFICE[0] * OFFICE[1]), "updates": len(times)})
    found.figures |= dict(
        zip(("median", "p99", "max"), np.quantile(times, (0.5, 0.99, 1.0)).round(4).tolist(), strict=True)
    )
    middle = len(memory) // 2
    growth = (memory[middle] - memory[0]) / middle, (memory[-1] - memory[middle]) / (len(memory) - 1 - middle)
    found.figures |= {"MiB per office": [round(value, 1) for value in growth], "message": sizes[-1]}
    if found.figures["p99"] > MAX_UPDATE:
        found.failures.append("updates take too long")
    if offices > 3 and growth[1] > MAX_GROWTH * growth[0]:
        found.failures.append("memory grows faster than the area")
    yield found
