"""Variants of simulated worlds: mirrored, with bent walls, with moved furniture, and with a crowd around the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.simulation import TemporaryShapes, World, WorldFile
from drivers.simulation.trajectory import follow_waypoints
from drivers.simulation.world import Box

from ....geometry.segments import Floats
from .buildings import CLEARANCE, distance_from_path

PIECE = 0.25
"""Metres, length of the straight pieces of a bent wall."""
MOVED = 2.0
"""Metres along both axes by which furniture is moved, at most."""
PERSON_RADIUS = 0.2
"""Metres."""
PEOPLE_STEP = 0.2
"""Seconds for which a person stands before the next step."""
NEAR, FAR = 0.7, 3.5
"""Metres between the robot and the people around it."""
CIRCLING = 0.4
"""Radians per second, standard deviation of the rate at which a person moves around the robot."""
BREATHING = 0.1
"""Hertz, frequency at which a person comes nearer and moves away."""


def mirror(world: World) -> World:
    """Return a world mirrored in the x axis. It has the other handedness: no motion makes it equal to the original."""

    def shapes(segments: Floats, circles: Floats) -> tuple[Floats, Floats]:
        return segments * [1.0, -1.0, 1.0, -1.0], circles * [1.0, -1.0, 1.0]

    segments, circles = shapes(world.segments, world.circles)
    temporary = tuple(TemporaryShapes(t.since, t.until, *shapes(t.segments, t.circles)) for t in world.temporary)
    return replace(
        world, segments=segments, circles=circles, waypoints=world.waypoints * [1.0, -1.0], temporary=temporary
    )


def bend(world: World, rms: float, wavelength: float, random: np.random.Generator) -> World:
    """Return a world whose permanent walls deviate from straight lines.

    rms         standard deviation of the deviation across each wall, metres
    wavelength  mean length of a wave along the wall, metres

    The deviation is a Gaussian process with the correlation exp(-d^2 / 2 l^2) over a distance d; its mean wavelength is
    2 pi l (Rice, Bell System Technical Journal 24, 1945).
    """
    bent = [_bent(segment, rms, wavelength / (2.0 * np.pi), random) for segment in world.segments]
    return replace(world, segments=np.concatenate(bent))


def _bent(segment: Floats, rms: float, scale: float, random: np.random.Generator) -> Floats:
    """Return the pieces (n, 4) of a segment (4,) that is bent with a correlation of the length `scale`."""
    ends = segment.reshape(2, 2)
    along = ends[1] - ends[0]
    size = float(np.hypot(*along))
    count = int(size / PIECE)
    if count < 2:
        return segment[None]
    share = np.linspace(0.0, 1.0, count + 1)
    distance = size * np.subtract.outer(share, share)
    covariance = np.exp(-0.5 * (distance / scale) ** 2) + 1e-9 * np.eye(count + 1)  # positive definite when rounded
    offset = rms * np.linalg.cholesky(covariance) @ random.standard_normal(count + 1)
    normal = np.array([-along[1], along[0]]) / size
    nodes = ends[0] + share[:, None] * along + offset[:, None] * normal
    return np.hstack([nodes[:-1], nodes[1:]])


def move_furniture(content: WorldFile, random: np.random.Generator) -> WorldFile:
    """Return the content of a world with each box elsewhere near its place and turned anyhow, beside the path."""
    path = np.array(content.path)
    return content.model_copy(update={"boxes": [_moved(box, path, random) for box in content.boxes]})


def _moved(box: Box, path: Floats, random: np.random.Generator) -> Box:
    while True:
        at = np.add(box.at, random.uniform(-MOVED, MOVED, 2))
        if distance_from_path(at, path) > np.hypot(*box.size) / 2 + CLEARANCE / 2:
            return box.model_copy(update={"at": tuple(at.tolist()), "turn": float(random.uniform(0.0, 90.0))})


def add_crowd(world: World, people: int, random: np.random.Generator, duration: float | None = None) -> World:
    """Return a world with people who accompany the robot.

    They circle around it at NEAR to FAR metres and come nearer and move away, like visitors around a robot in a museum;
    they walk through walls. `duration` is that of the drive, seconds; None for one that follows the way points once.
    """
    trajectory = follow_waypoints(world.waypoints, world.speed, duration)
    start, phase = random.uniform(-np.pi, np.pi, (2, people))
    rate = CIRCLING * random.standard_normal(people)
    steps = []
    for since in np.arange(0.0, trajectory.duration, PEOPLE_STEP):
        robot = trajectory.poses_at(np.array([since + PEOPLE_STEP / 2]))[0]
        share = 0.5 + 0.5 * np.sin(2 * np.pi * BREATHING * since + phase)
        distance, direction = NEAR + (FAR - NEAR) * share, start + rate * since
        circles = np.column_stack(
            [
                robot[0] + distance * np.cos(direction),
                robot[1] + distance * np.sin(direction),
                np.full(people, PERSON_RADIUS),
            ]
        )
        steps.append(TemporaryShapes(float(since), float(since) + PEOPLE_STEP, np.zeros((0, 4)), circles))
    return replace(world, temporary=(*world.temporary, *steps))
