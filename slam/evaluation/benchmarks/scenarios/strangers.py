"""Draw everything of a simulated drive from a seed: building, lidar and its mount, wheels, speed and people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.simulation import LidarModel, Simulation, WheelModel, World, build_world, load_world_file

from .buildings import random_building, room_with_boxes
from .world_variants import add_crowd, bend, move_furniture

OTHER_WORLDS = "office", "columns", "museum"
"""Worlds of the package among the drawn ones."""
BENT_RMS, BENT_WAVELENGTH = 0.01, 3.0
"""Metres, of bent walls."""
MAX_PEOPLE = 8
"""People around the robot, at most."""


def stranger(seed: int, furniture: np.random.Generator | None = None) -> Simulation:
    """Return a drive drawn from a seed; the ranges of all parameters are those of robots and lidars on sale.

    furniture  draws other furniture in the same building

    The lidar has 180 to 1440 beams in 180 to 360 degrees, 4 to 20 revolutions per second, a range of 5 to 30 m, noise
    of 3 to 30 mm, and any mount within 0.2 m. The systematic errors of the wheels are up to those of the simulator's
    bad ones.
    """
    random = np.random.default_rng([seed, 1])
    world = _world(seed, random, furniture)
    lidar = LidarModel(
        beams=int(random.choice([180, 360, 500, 720, 1080, 1440])),
        rate=float(np.exp(random.uniform(np.log(4.0), np.log(20.0)))),
        field_of_view=float(np.radians(random.choice([180.0, 240.0, 270.0, 360.0]))),
        range_max=float(np.exp(random.uniform(np.log(5.0), np.log(30.0)))),
        sigma_range=float(np.exp(random.uniform(np.log(0.003), np.log(0.03)))),
        sigma_bearing=float(np.radians(random.uniform(0.0, 0.1))),
        dropouts=float(random.uniform(0.0, 0.1)),
    )
    wear = float(random.random())
    wheels = WheelModel(
        rate=float(random.uniform(10.0, 50.0)),
        slip=0.003 + 0.012 * wear,
        encoder=0.0002 + 0.0003 * wear,
        scale_bias=0.01 + 0.03 * wear,
        difference_bias=0.001 + 0.003 * wear,
        wheelbase_bias=0.01 + 0.04 * wear,
    )
    x, y = random.uniform(-0.2, 0.2, 2).tolist()
    mount = (x, y, float(random.choice([0.0, random.uniform(-np.pi, np.pi)])))
    return Simulation(world, seed, None, lidar, wheels, mount)


def _world(seed: int, random: np.random.Generator, furniture: np.random.Generator | None) -> World:
    kind = random.random()
    if kind < 0.5:
        world = random_building(seed, furniture)
    elif kind < 0.75:
        world = room_with_boxes(seed, furniture=furniture)
    else:
        name = str(random.choice(OTHER_WORLDS))
        content = load_world_file(name)
        world = build_world(name, content if furniture is None else move_furniture(content, furniture))
    world = replace(world, speed=world.speed * float(random.uniform(0.5, 1.5)))
    if random.random() < 0.3:
        world = bend(world, BENT_RMS, BENT_WAVELENGTH, random)
    people = int(random.integers(0, MAX_PEOPLE + 1)) if random.random() < 0.3 else 0
    return add_crowd(world, people, random) if people else world
