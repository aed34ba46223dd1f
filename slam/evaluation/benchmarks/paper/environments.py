"""Simulate the paper's two environments: one sweep of each with known walls and corners.

The association of rays with walls is taken from the world, not from a segmentation: the paper's tables compare line
fits, and all fits get the same rays.
"""

from __future__ import annotations

import numpy as np

from drivers.immutable import immutable
from drivers.simulation import World, load_world
from drivers.simulation.raycast import cast_beams
from features import Noise, arras_siegwart
from features.corner import intersect
from features.corner_angle import MIN_SINE

from ....geometry.segments import Floats, Integers

PAPER_NOISE = Noise(sigma_range=0.05, sigma_bearing=float(np.radians(0.391 / 2)))
"""Standard deviations that the paper takes from the RPLIDAR S1's data sheet (section V)."""

MIN_RAYS = 5
"""Of a segment; door jambs have fewer."""
CHORDS = 3
"""Straight segments into which a curved wall is split."""
MAX_RANGE_DIFFERENCE = 0.5
"""Metres between the range of a corner and those of the adjacent rays."""
MAX_STEPS_OUTSIDE = 1.5
MAX_STEPS_OUTSIDE_CURVE = 3.5
"""Bearing steps by which a corner may lie outside the gap between its walls; more for the chord of a curve, which
intersects the next wall slightly beside the curve's end."""
EXACT = Noise(1e-4, 1e-6)
"""For fits to noise-free rays, whose covariance is not used."""


@immutable
class Segment:
    """Consecutive rays on one wall.

    rays   (n,) indices, in order
    wall   index of the world's segment, or -1 - index of its circle
    """

    rays: Integers
    wall: int


@immutable
class Environment:
    """View of a world from one pose, in the sensor's frame.

    angles, ranges  (n,) of the rays that return, radians and metres, without noise
    segments        in the order of their bearings
    corners         (m, 2) segments before and after each corner; row k - 1 is the paper's corner k
    positions       (m, 2) of the corners, metres
    sensor          x, y, heading in the world
    """

    name: str
    world: World
    sensor: Floats
    angles: Floats
    ranges: Floats
    segments: list[Segment]
    corners: Integers
    positions: Floats

    def rays_of_corner(self, number: int) -> tuple[Integers, ...]:
        """Return the rays of both walls of corner `number` (from 1), sorted by their distance to the corner."""
        before, after = self.corners[number - 1]
        return self.segments[before].rays[::-1], self.segments[after].rays

    def measure(self, random: np.random.Generator, noise: Noise = PAPER_NOISE) -> Floats:
        """Return noisy ranges (n,), each ray on its own wall.

        A ray whose bearing noise exceeds the wall's end hits the continuation of the wall, because the association of
        rays with walls is given.
        """
        bearing_noise, range_noise = random.standard_normal((2, len(self.angles)))
        directions = self.angles + noise.sigma_bearing * bearing_noise
        ranges = self.ranges.copy()
        for segment in self.segments:
            bearings = directions[segment.rays] + self.sensor[2]
            ranges[segment.rays] = _ranges_to_wall(self.world, segment.wall, self.sensor, bearings)
        return np.asarray(ranges + noise.sigma_range * range_noise)

    def sweep(self, random: np.random.Generator, noise: Noise) -> Floats:
        """Return noisy ranges (n,) to whichever wall each ray hits, as a real sensor does."""
        bearing_noise, range_noise = random.standard_normal((2, len(self.angles)))
        exact = _cast(self.world, self.sensor, self.angles + noise.sigma_bearing * bearing_noise)
        return np.asarray(exact + noise.sigma_range * range_noise)


def environment(name: str, world: str, *, beams: int, lost: int) -> Environment:
    """Return the view from the first waypoint of a world, in the direction of the second.

    `lost` of `beams` are no-returns, evenly spread over the revolution.
    """
    loaded = load_world(world)
    ahead = loaded.waypoints[1] - loaded.waypoints[0]
    sensor = np.array([*loaded.waypoints[0], np.arctan2(ahead[1], ahead[0])])
    no_returns = ((np.arange(lost) + 0.5) * beams / max(lost, 1)).astype(np.int64)
    angles = np.delete(-np.pi + 2 * np.pi / beams * (np.arange(beams) + 0.5), no_returns)
    ranges = _cast(loaded, sensor, angles)
    segments = _segments(loaded, sensor, angles, ranges)
    corners, positions = _corners(segments, angles, ranges, 2 * np.pi / beams)
    return Environment(name, loaded, sensor, angles, ranges, segments, corners, positions)


def environment_a() -> Environment:
    """Return environment A: 920 beams per revolution, 0.391 degrees apart, of which 884 return."""
    return environment("A", "paper-a", beams=920, lost=36)


def environment_b() -> Environment:
    """Return environment B: 1112 beams per revolution, from a slower rotation; all return."""
    return environment("B", "paper-b", beams=1112, lost=0)


def _cast(world: World, sensor: Floats, angles: Floats) -> Floats:
    still = np.zeros((1, 2))
    return cast_beams(np.zeros(len(angles)), angles, np.zeros(3), sensor[None], still, world.segments, world.circles)


def _segments(world: World, sensor: Floats, angles: Floats, ranges: Floats) -> list[Segment]:
    """Return the segments: consecutive rays on one wall, split on curves; short ones are left out.

    A segment that spans the first and the last ray is not split.
    """
    wall = _walls(world, sensor, angles, ranges)
    start = int(np.flatnonzero(wall != np.roll(wall, 1))[0])
    order = np.roll(np.arange(len(angles)), -start)
    found = []
    for run in np.split(order, np.flatnonzero(np.diff(wall[order])) + 1):
        index = int(wall[run[0]])
        found += [Segment(part, index) for part in np.array_split(run, 1 if index >= 0 else CHORDS)]
    return [segment for segment in found if len(segment.rays) >= MIN_RAYS]


def _walls(world: World, sensor: Floats, angles: Floats, ranges: Floats) -> Integers:
    """Return the wall (n,) of each ray: the nearest to its end point."""
    bearings = angles + sensor[2]
    points = sensor[:2] + ranges[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    starts, along = world.segments[:, :2], world.segments[:, 2:] - world.segments[:, :2]
    share = np.einsum("nmk,mk->nm", points[:, None] - starts, along) / np.sum(along**2, axis=1)
    feet = starts + share.clip(0.0, 1.0)[..., None] * along
    to_walls = np.linalg.norm(points[:, None] - feet, axis=2)
    to_circles = np.abs(np.linalg.norm(points[:, None] - world.circles[:, :2], axis=2) - world.circles[:, 2])
    nearest = np.hstack([to_walls, to_circles]).argmin(axis=1)
    count = len(world.segments)
    return np.asarray(np.where(nearest < count, nearest, count - 1 - nearest), dtype=np.int64)


def _ranges_to_wall(world: World, wall: int, sensor: Floats, bearings: Floats) -> Floats:
    """Return the ranges (n,) along world bearings (n,) to a wall or its straight continuation, or to a circle."""
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    if wall >= 0:
        start, along = world.segments[wall, :2] - sensor[:2], world.segments[wall, 2:] - world.segments[wall, :2]
        normal = np.array([-along[1], along[0]])
        return np.asarray((normal @ start) / (directions @ normal))
    circle = world.circles[-1 - wall]
    centre = circle[:2] - sensor[:2]
    middle = directions @ centre
    half = np.sqrt(np.maximum(circle[2] ** 2 - (centre @ centre - middle**2), 0.0))
    return np.asarray(middle - half)


def _corners(segments: list[Segment], angles: Floats, ranges: Floats, step: float) -> tuple[Integers, Floats]:
    """Return the corners of adjacent segments: pairs (m, 2) and positions (m, 2), sorted by bearing from -pi."""
    lines = [arras_siegwart.fit(ranges[s.rays], angles[s.rays], EXACT).uv for s in segments]
    unknown = np.zeros((2, 2))
    found = []
    for after, second in enumerate(segments):
        before = (after - 1) % len(segments)
        (u1, v1), (u2, v2) = lines[before], lines[after]
        if abs(u1 * v2 - u2 * v1) <= MIN_SINE * np.hypot(u1, v1) * np.hypot(u2, v2):
            continue
        x, y = intersect(u1, v1, unknown, u2, v2, unknown)[:2]
        last, first = segments[before].rays[-1], second.rays[0]
        gap = (angles[first] - angles[last]) % (2 * np.pi)
        beyond = (np.arctan2(y, x) - angles[last] + np.pi) % (2 * np.pi) - np.pi
        straight = min(segments[before].wall, second.wall) >= 0
        margin = (MAX_STEPS_OUTSIDE if straight else MAX_STEPS_OUTSIDE_CURVE) * step
        near = np.abs(np.hypot(x, y) - ranges[[last, first]]).max() < MAX_RANGE_DIFFERENCE
        if near and -margin <= beyond <= gap + margin:
            found.append((float(np.arctan2(y, x)), before, after, x, y))
    found.sort()
    pairs = np.array([(before, after) for _, before, after, _, _ in found], dtype=np.int64)
    return pairs, np.array([(x, y) for *_, x, y in found])
