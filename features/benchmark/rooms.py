"""Simulated scans with ground truth: rooms with recesses, cabinets and boxes, or with an arc and columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Floats, Integers, Noise

# Instead of the index of a surface: no return, or a spurious one.
NOTHING = -1

# Beams of a revolution and size of the room in metres, alternating: the two environments of the paper.
SIZES = ((1112, (5.0, 3.0)), (884, (12.0, 8.0)))

# Share of beams without a return.
DROPPED = 0.01

# Metres; difference of neighbouring ranges at an edge.
EDGE = 0.2
# Share of the rays at edges that return a mixed range.
MIXED = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """Surfaces of a room.

    walls  (k, 4) x0 y0 x1 y1, metres
    arcs   (m, 5) x y of the centre and radius, metres; begin and extent of the arc, radians
    """

    walls: Floats
    arcs: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RoomScan:
    """One scan with ground truth.

    ranges, angles  (n,) as measured; NaN for no-returns
    true_ranges     (n,) without noise
    surface         (n,) index of the surface that the beam hit, walls before arcs; NOTHING if spurious or lost
    walls           (k, 4) x0 y0 x1 y1 in the lidar's frame, metres
    """

    ranges: Floats
    angles: Floats
    true_ranges: Floats
    surface: Integers
    walls: Floats


def polygon(points: Floats) -> Floats:
    """Return the walls (k, 4) of a polygon with the vertices (k, 2)."""
    return np.hstack([points, np.roll(points, -1, axis=0)])


def box(x: float, y: float, width: float, height: float, turn: float) -> Floats:
    """Return the four walls of a box with a corner at (x, y), rotated about it."""
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    return polygon(corners @ np.array([[c, s], [-s, c]]) + (x, y))


def furnished_room(rng: np.random.Generator, width: float, height: float) -> Room:
    """Return a room with a recess and a cabinet at its walls, and two boxes in it."""
    recess, depth = rng.uniform(0.2, 0.5) * width, rng.uniform(0.15, 0.5)
    niche = rng.uniform(0.6, 1.2)
    cabinet, thickness = rng.uniform(0.1, 0.6) * width, rng.uniform(0.3, 0.5)
    outline = [(0, 0), (cabinet, 0), (cabinet, thickness), (cabinet + 0.9, thickness), (cabinet + 0.9, 0), (width, 0)]
    outline += [(width, height), (recess + niche, height), (recess + niche, height + depth)]
    outline += [(recess, height + depth), (recess, height), (0, height)]
    boxes = []
    for _ in range(2):
        x, y = rng.uniform(0.1, 0.8) * width, rng.uniform(0.55, 0.75) * height
        long, wide = rng.uniform(0.3, 0.7, 2).tolist()
        boxes.append(box(x, y, long, wide, rng.uniform(0.0, 3.0)))
    return Room(np.vstack([polygon(np.array(outline, dtype=np.float64)), *boxes]), np.zeros((0, 5)))


def round_room(rng: np.random.Generator, width: float, height: float) -> Room:
    """Return a room with an arc at one end and four round columns along its far wall."""
    bulge = rng.uniform(0.15, 0.5) * height  # of the arc beyond the room's end; a semicircle if half the height
    radius = (0.25 * height**2 + bulge**2) / (2.0 * bulge)
    opening = np.arcsin(0.5 * height / radius)
    end = (width + bulge - radius, 0.5 * height, radius, -opening, 2.0 * opening)
    columns = [
        (share * width, rng.uniform(0.6, 0.75) * height, rng.uniform(0.03, 0.1) * height, 0.0, 2.0 * np.pi)
        for share in (0.15, 0.4, 0.65, 0.9)
    ]
    walls = [(0.0, 0.0, width, 0.0), (width, height, 0.0, height), (0.0, height, 0.0, 0.0)]
    return Room(np.array(walls), np.array([end, *columns]))


def cast(room: Room, position: Floats, bearings: Floats) -> tuple[Floats, Integers]:
    """Return range (n,) and index (n,) of the nearest surface along every bearing; infinity and NOTHING if none."""
    direction = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    start, along = room.walls[:, :2] - position, room.walls[:, 2:] - room.walls[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = direction[:, :1] * along[:, 1] - direction[:, 1:] * along[:, 0]
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * direction[:, 1:] - start[:, 1] * direction[:, :1]) / cross
        distance = np.where((distance > 0.0) & (share >= 0.0) & (share <= 1.0), distance, np.inf)
        distance = np.hstack([distance, _to_arcs(room.arcs, position, direction)])
    nearest = distance.argmin(axis=1)
    ranges = distance[np.arange(len(bearings)), nearest]
    return ranges, np.where(np.isfinite(ranges), nearest, NOTHING)


def _to_arcs(arcs: Floats, position: Floats, direction: Floats) -> Floats:
    """Return distances (n, m) to arcs along unit vectors (n, 2); infinity if an arc is not hit."""
    nearest = np.full((len(direction), len(arcs)), np.inf)
    for k, (x, y, radius, begin, extent) in enumerate(arcs):
        centre = np.array([x, y]) - position
        along = direction @ centre
        inside = along**2 - centre @ centre + radius**2
        for sign in (1.0, -1.0):  # the nearer intersection last, so that it overwrites
            distance = along + sign * np.sqrt(inside)
            offset = direction * distance[:, None] - centre
            turned = (np.arctan2(offset[:, 1], offset[:, 0]) - begin) % (2.0 * np.pi)
            hit = (inside > 0.0) & (distance > 0.0) & (turned <= extent)
            nearest[hit, k] = distance[hit]
    return nearest


def simulate(
    rng: np.random.Generator,
    noise: Noise,
    *,
    number: int,
    outliers: float = 0.0,
    curved: bool = False,
    beams: int | None = None,
) -> RoomScan:
    """Simulate one revolution at a random position in a random room.

    number    selects the size of the room, alternating
    outliers  share of returns that are too short; if positive, rays at edges may return mixed ranges as well
    curved    with an arc and columns instead of boxes
    beams     of the revolution; by default those of the room's size
    """
    default_beams, size = SIZES[number % len(SIZES)]
    beams = default_beams if beams is None else beams
    room = (round_room if curved else furnished_room)(rng, *size)
    position = np.array([rng.uniform(0.25, 0.75) * size[0], rng.uniform(0.25, 0.45) * size[1]])
    heading = rng.uniform(-np.pi, np.pi)
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    bearings = angles + rng.normal(0.0, noise.sigma_bearing, beams)
    true_ranges, surface = cast(room, position, bearings + heading)
    ranges = np.asarray(true_ranges + rng.normal(0.0, noise.sigma_range, beams), dtype=np.float64)
    if outliers > 0.0:
        edges = np.flatnonzero(np.abs(np.diff(true_ranges)) > EDGE)
        mixed = edges[rng.random(len(edges)) < MIXED]
        share = rng.uniform(0.1, 0.9, len(mixed))
        ranges[mixed] = share * true_ranges[mixed] + (1.0 - share) * true_ranges[mixed + 1]
        short = rng.random(beams) < outliers
        ranges[short] *= rng.uniform(0.2, 0.95, short.sum())
        surface[mixed], surface[short] = NOTHING, NOTHING
    lost = rng.random(beams) < DROPPED
    ranges[lost], surface[lost] = np.nan, NOTHING
    c, s = np.cos(heading), np.sin(heading)
    rotation = np.array([[c, -s], [s, c]])
    walls = np.hstack([(room.walls[:, :2] - position) @ rotation, (room.walls[:, 2:] - position) @ rotation])
    return RoomScan(ranges, angles, true_ranges, surface, walls)
