"""Long drives, and drives in a place that was mapped on an earlier day, with everything drawn from a seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drivers.messages import Message
from drivers.simulation import Simulation

from ....geometry.segments import Floats
from .strangers import stranger

MAX_BEAMS, MAX_RATE = 360, 7.0
"""Per revolution, and revolutions per second: of lidars of small robots, so that long drives take little time."""
PATROL_SECONDS = 600.0
"""Of a long drive: several rounds of the same tour."""
LATER_SECONDS = 120.0
"""Of a drive in a known place."""
DAY = 86_400.0
"""Seconds."""
OTHER_NOISE = 1_000_000
"""Added to the seed of the later drive: another noise, and other errors of the wheels."""


@dataclass(frozen=True, slots=True)
class LaterDrive:
    """A part of a simulated drive on a later day, which begins anywhere on the tour.

    skipped  seconds of the simulation before the beginning
    shift    seconds added to the simulation's stamps
    """

    simulation: Simulation
    skipped: float
    shift: float

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages."""
        for message in self.simulation:
            if message.stamp >= self.skipped:
                yield replace(message, stamp=message.stamp + self.shift)

    def true_poses(self, stamps: Floats) -> Floats:
        """Return the true poses (n, 3) in the simulation's frame, which is that of the earlier drive."""
        return self.simulation.trajectory.poses_at(stamps - self.shift)


def small_stranger(seed: int, seconds: float | None = None, furniture: np.random.Generator | None = None) -> Simulation:
    """Return a drive drawn from a seed like that of `stranger`, with a lidar of a small robot.

    seconds    its duration, in which the tour is repeated; None follows it once
    furniture  draws other furniture in the same building
    """
    drawn = stranger(seed, furniture)
    lidar = replace(drawn.lidar, beams=min(drawn.lidar.beams, MAX_BEAMS), rate=min(drawn.lidar.rate, MAX_RATE))
    return Simulation(drawn.world, seed, seconds, lidar, drawn.wheels, drawn.mount)


def later_drive(earlier: Simulation, *, refurnished: bool = False) -> LaterDrive:
    """Return a drive in the world of an earlier one, on the next day, with other errors of the wheels.

    refurnished  True if the earlier one is by `small_stranger`, and the furniture is another one now
    """
    tour = earlier.trajectory.duration
    skipped = float(np.random.default_rng([earlier.seed, 2]).uniform(0.0, tour))
    seed, end = earlier.seed + OTHER_NOISE, skipped + LATER_SECONDS
    world = earlier.world
    if refurnished:
        world = small_stranger(earlier.seed, furniture=np.random.default_rng([earlier.seed, 3])).world
    later = Simulation(world, seed, end, earlier.lidar, earlier.wheels, earlier.mount)
    return LaterDrive(later, skipped, DAY)
