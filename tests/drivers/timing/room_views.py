"""Drives of a lidar through simple rooms, given by the range in each direction."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from drivers import se2
from drivers.messages import Floats, Message, Odometry, Scan

ANGLES = np.radians(np.arange(-180.0, 180.0) + 0.4)  # none parallel to a wall, where a distance would be infinite
RANGE_MAX = 12.0
MOUNT = np.array([0.1, 0.0, 0.0])
World = Callable[[Floats], Floats]
"""Function of a lidar's pose (3,) that returns the range in each of ANGLES, infinite where there is nothing."""


def room(width: float, depth: float) -> World:
    """Return a rectangular room around the origin."""

    def ranges(pose: Floats) -> Floats:
        x, y = np.cos(pose[2] + ANGLES), np.sin(pose[2] + ANGLES)
        to_sides = (np.where(x > 0.0, width / 2, -width / 2) - pose[0]) / x
        to_ends = (np.where(y > 0.0, depth / 2, -depth / 2) - pose[1]) / y
        return np.asarray(np.minimum(to_sides, to_ends))

    return ranges


def round_room(radius: float) -> World:
    """Return a round room around the origin."""

    def ranges(pose: Floats) -> Floats:
        directions = np.column_stack([np.cos(pose[2] + ANGLES), np.sin(pose[2] + ANGLES)])
        along = -directions @ pose[:2]
        return np.asarray(along + np.sqrt(along**2 + radius**2 - pose[:2] @ pose[:2]))

    return ranges


def seeing_line(world: World, distance: float, bearing: float, width: float = np.pi, nodding: float = 0.0) -> World:
    """Return a world with a line that is fixed in the lidar's frame, seen up to `width` to both sides of `bearing`.

    nodding  standard deviation of its distance from scan to scan, as a part of it
    """
    random = np.random.default_rng(1)

    def ranges(pose: Floats) -> Floats:
        aside = se2.wrap(ANGLES - bearing)
        reach = distance * (1.0 + nodding * random.standard_normal()) / np.cos(aside)
        return np.minimum(world(pose), np.where((reach > 0.0) & (np.abs(aside) < width), reach, np.inf))

    return ranges


def spinning(turns: float = 2.0) -> Floats:
    """Return the path (n, 3) of a robot that turns on the spot."""
    headings = np.arange(0.0, 2.0 * np.pi * turns, np.radians(5.0))
    return np.column_stack([np.full((len(headings), 2), [0.3, -0.2]), headings])


def drive(world: World, path: Floats, range_max: float = RANGE_MAX) -> Iterator[Message]:
    """Yield the messages on a path through a world, with 1 % noise of the ranges."""
    random, zeros = np.random.default_rng(0), np.zeros(len(ANGLES))
    for number, pose in enumerate(path):
        yield Odometry(0.1 * number, pose)
        ranges = world(se2.compose(pose, MOUNT)) * (1.0 + 0.01 * random.standard_normal(len(ANGLES)))
        ranges[ranges > range_max] = np.nan
        yield Scan(0.1 * number, ranges, ANGLES, zeros, 0.1, range_max, MOUNT)
