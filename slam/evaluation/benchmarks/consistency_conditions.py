"""Conditions of the consistency benchmark: sensors, systematic errors and worlds, most of which no model describes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, LidarModel, WheelModel, World, load_world

from .scenarios.buildings import random_building, room_with_boxes
from .scenarios.log_variants import LogVariant, crop, disturb, quantise, stamp_late, stamp_odometry_inexactly
from .scenarios.world_variants import bend

MOUNT = (0.2, -0.15, math.radians(100.0))
"""x, y, heading of the lidar on the base, metres, metres, radians: off-centre and turned, to reveal errors that a
centred lidar that looks ahead would hide."""
MOUNT_AHEAD = (*MOUNT[:2], 0.0)
"""The same for a lidar whose field of view is a half circle."""
BENT_RMS, BENT_WAVELENGTH = 0.003, 2.0
"""Metres: deviation of a wall from a straight line, and its wavelength along the wall."""


class Building(NamedTuple):
    """A world to drive in, and the world with the walls that an estimate is compared with."""

    world: World
    straight: World


@dataclass(frozen=True, slots=True)
class Condition:
    """Conditions of a simulated drive.

    description  for tables and the help
    building     function of the drive's seed
    lidar, wheels, mount  as for a Simulation
    log          change of the messages, if any
    """

    description: str
    building: Callable[[int], Building]
    lidar: LidarModel = LIDAR_MODELS["long"]
    wheels: WheelModel = WHEEL_MODELS["good"]
    mount: tuple[float, float, float] = MOUNT
    log: LogVariant | None = None


def _named(name: str) -> Callable[[int], Building]:
    def building(_: int) -> Building:
        world = load_world(name)
        return Building(world, world)

    return building


def _drawn(draw: Callable[[int], World]) -> Callable[[int], Building]:
    def building(seed: int) -> Building:
        world = draw(seed)
        return Building(world, world)

    return building


def _bent_office(seed: int) -> Building:
    straight = load_world("office")
    return Building(bend(straight, BENT_RMS, BENT_WAVELENGTH, np.random.default_rng(seed)), straight)


OFFICE, LIDAR = _named("office"), LIDAR_MODELS["long"]
CONDITIONS: dict[str, Condition] = {
    "nominal": Condition("an office, with the errors that are modelled", OFFICE),
    "range-noise-5mm": Condition("range noise of 5 mm", OFFICE, replace(LIDAR, sigma_range=0.005)),
    "range-noise-3cm": Condition("range noise of 3 cm", OFFICE, replace(LIDAR, sigma_range=0.03)),
    "half-circle": Condition(
        "181 beams over 180 degrees, ranges in steps of 1 cm",
        OFFICE,
        replace(LIDAR, beams=360),
        mount=MOUNT_AHEAD,
        log=lambda messages, random: quantise(0.01)(crop(math.pi / 2)(messages, random), random),
    ),
    "range-bias": Condition("all ranges 5 mm too long", OFFICE, replace(LIDAR, range_bias=0.005)),
    "bent-walls": Condition("walls bent by 3 mm rms in waves of 2 m", _bent_office),
    "spin-2hz": Condition("a lidar that turns twice a second", OFFICE, replace(LIDAR, rate=2.0)),
    "bad-wheels": Condition("worn wheels", OFFICE, wheels=WHEEL_MODELS["bad"]),
    "bearing-noise": Condition("bearing noise of 0.2 degrees", OFFICE, replace(LIDAR, sigma_bearing=math.radians(0.2))),
    "outliers": Condition("5 % of the ranges 5 cm too long", OFFICE, log=disturb(0.05, 0.05)),
    "late-scans": Condition("scans stamped 20 ms late", OFFICE, log=stamp_late(0.02)),
    "inexact-stamps": Condition("stamps of odometry that are off by 10 ms", OFFICE, log=stamp_odometry_inexactly(0.01)),
    "corridor": Condition("a corridor of 40 m with doors", _named("corridor")),
    "columns": Condition("a hall with round columns", _named("columns")),
    "boxes": Condition("two rooms with 16 boxes, others for each seed", _drawn(room_with_boxes)),
    "buildings": Condition("another building for each seed", _drawn(random_building)),
    "worn-buildings": Condition(
        "the same, worn wheels and a lidar with a range of 6 m",
        _drawn(random_building),
        LIDAR_MODELS["short"],
        WHEEL_MODELS["bad"],
    ),
    "sparse-buildings": Condition(
        "the same, good wheels and 120 beams with a range of 6 m",
        _drawn(random_building),
        replace(LIDAR_MODELS["short"], beams=120),
    ),
}
"""Conditions by name."""
