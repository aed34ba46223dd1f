"""Rooms to scan: a ray caster on wall segments, noise, spurious returns, and the true walls and corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from features import Extractor, Features


@dataclass
class Scan:
    """One simulated scan with the truth: per ray the wall it hit (-1: none, or spurious)."""

    ranges: np.ndarray
    angles: np.ndarray
    true_ranges: np.ndarray
    wall: np.ndarray  # (n,) index of the wall
    walls: np.ndarray  # (k, 4) x0 y0 x1 y1, in the lidar's frame


def polygon(points: list[tuple[float, float]]) -> np.ndarray:
    vertices = np.array(points, dtype=float)
    return np.hstack([vertices, np.roll(vertices, -1, axis=0)])


def box(x: float, y: float, width: float, height: float, turn: float = 0.0) -> np.ndarray:
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=float)
    c, s = np.cos(turn), np.sin(turn)
    return polygon([tuple(p) for p in corners @ np.array([[c, s], [-s, c]]) + (x, y)])


def cast(walls: np.ndarray, position: np.ndarray, bearings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range to and index of the nearest wall along every bearing; infinity and -1 where there is none."""
    direction = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    start, along = walls[:, :2] - position, walls[:, 2:] - walls[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = direction[:, :1] * along[:, 1] - direction[:, 1:] * along[:, 0]
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        where = (start[:, 0] * direction[:, 1:] - start[:, 1] * direction[:, :1]) / cross
        distance = np.where((distance > 0) & (where >= 0) & (where <= 1), distance, np.inf)
    nearest = distance.argmin(axis=1)
    ranges = distance[np.arange(len(bearings)), nearest]
    return ranges, np.where(np.isfinite(ranges), nearest, -1)


def furnished_room(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """A room whose walls have a recess and a cabinet, and with two boxes in it."""
    recess, depth = rng.uniform(0.2, 0.5) * width, rng.uniform(0.15, 0.5)
    niche = rng.uniform(0.6, 1.2)
    cabinet, thickness = rng.uniform(0.1, 0.6) * width, rng.uniform(0.3, 0.5)
    outline = [(0, 0), (cabinet, 0), (cabinet, thickness), (cabinet + 0.9, thickness), (cabinet + 0.9, 0), (width, 0)]
    outline += [(width, height), (recess + niche, height), (recess + niche, height + depth)]
    outline += [(recess, height + depth), (recess, height), (0, height)]
    boxes = [
        box(
            rng.uniform(0.1, 0.8) * width,
            rng.uniform(0.55, 0.75) * height,
            *rng.uniform(0.3, 0.7, 2),
            rng.uniform(0, 3),
        )
        for _ in range(2)
    ]
    return np.vstack([polygon(outline), *boxes])


def simulate(
    seed: int,
    *,
    beams: int = 1112,
    size: tuple[float, float] = (5.0, 3.0),
    sigma_range: float = 0.01,
    sigma_bearing: float = np.radians(0.05),
    outliers: float = 0.0,
    span: float = 2 * np.pi,
    walls: np.ndarray | None = None,
    position: tuple[float, float] | None = None,
) -> Scan:
    """A scan from within a room, seeded. `outliers`: share of short returns; then mixed pixels at range edges too."""
    rng = np.random.default_rng(seed)
    if walls is None:
        walls = furnished_room(rng, *size)
        position = (rng.uniform(0.25, 0.75) * size[0], rng.uniform(0.25, 0.45) * size[1])
    heading = rng.uniform(-np.pi, np.pi)
    place = np.array(position)
    angles = -span / 2 + span / beams * np.arange(beams)
    true_bearings = angles + rng.normal(0, sigma_bearing, beams)
    true_ranges, wall = cast(walls, place, true_bearings + heading)
    ranges = true_ranges + rng.normal(0, sigma_range, beams)
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s], [s, c]])
    local = np.hstack([(walls[:, :2] - place) @ turn, (walls[:, 2:] - place) @ turn])
    if outliers:
        edges = np.flatnonzero(np.abs(np.diff(true_ranges)) > 0.2)
        mixed = edges[rng.random(len(edges)) < 0.7]
        share = rng.uniform(0.1, 0.9, len(mixed))
        ranges[mixed] = share * true_ranges[mixed] + (1 - share) * true_ranges[mixed + 1]
        short = rng.random(beams) < outliers
        ranges[short] *= rng.uniform(0.2, 0.95, short.sum())
        wall = wall.copy()
        wall[mixed], wall[short] = -1, -1
    lost = rng.random(beams) < 0.01
    ranges[lost] = np.nan
    return Scan(ranges, angles, true_ranges, wall, local)


def true_runs(scan: Scan) -> list[tuple[int, np.ndarray]]:
    """(wall, its rays in order) of every uninterrupted sight of a wall; spurious and lost rays interrupt nothing."""
    rays = np.flatnonzero((scan.wall >= 0) & np.isfinite(scan.ranges))
    starts = np.flatnonzero(scan.wall[rays] != np.roll(scan.wall[rays], 1))
    if len(starts) == 0:
        return [(int(scan.wall[rays[0]]), rays)]
    rays = np.roll(rays, -starts[0])
    return [
        (int(scan.wall[part[0]]), part) for part in np.split(rays, np.flatnonzero(np.diff(scan.wall[rays]) != 0) + 1)
    ]


@dataclass
class Score:
    """Counts over scans: walls found of those there, lines that are walls of those given, corners likewise."""

    found: int = 0
    there: int = 0
    right: int = 0
    given: int = 0
    corners_found: int = 0
    corners_there: int = 0
    corners_right: int = 0
    corners_given: int = 0

    def __post_init__(self) -> None:
        self.line_nees: list[float] = []
        self.corner_nees: list[float] = []

    @property
    def precision(self) -> float:
        return self.right / self.given

    @property
    def recall(self) -> float:
        return self.found / self.there

    @property
    def corner_recall(self) -> float:
        return self.corners_found / self.corners_there

    @property
    def corner_precision(self) -> float:
        return self.corners_right / self.corners_given


def rays_of_line(first: int, last: int, beams: int) -> np.ndarray:
    return np.arange(first, last + 1 if last >= first else last + 1 + beams) % beams


def uv_of_wall(wall: np.ndarray) -> np.ndarray:
    (x0, y0), (x1, y1) = wall[:2], wall[2:]
    return np.array([y1 - y0, x0 - x1]) / (x0 * y1 - x1 * y0)


def score(scan: Scan, features: Features, into: Score, sigma_range: float) -> None:
    """Add one scan: a wall counts from 10 rays and 0.3 m; a line is that wall if their rays overlap by half (IoU)."""
    lines, corners = features.lines, features.corners
    beams = len(scan.ranges)
    runs = true_runs(scan)
    length = []
    for _, rays in runs:
        ends = scan.true_ranges[rays[[0, -1]], None] * np.stack(
            [np.cos(scan.angles[rays[[0, -1]]]), np.sin(scan.angles[rays[[0, -1]]])], axis=1
        )
        length.append(np.hypot(*(ends[1] - ends[0])))
    counted = [len(rays) >= 10 and size >= 0.3 for (_, rays), size in zip(runs, length, strict=True)]
    given = [set(rays_of_line(a, b, beams)) for a, b in zip(lines.first, lines.last, strict=True)]
    sizes = np.hypot(*(lines.end - lines.start).T)
    there = [set(rays) for _, rays in runs]

    def overlap(i: int, j: int) -> bool:
        return len(there[i] & given[j]) >= 0.5 * len(there[i] | given[j])

    into.there += sum(counted)
    for i, (wall, _) in enumerate(runs):
        if counted[i]:
            match = [j for j in range(len(given)) if overlap(i, j)]
            into.found += bool(match)
            for j in match:
                error = lines.uv[j] - uv_of_wall(scan.walls[wall])
                into.line_nees.append(float(error @ np.linalg.solve(lines.covariance[j], error)))
    for j in range(len(given)):
        if lines.count[j] >= 10 and sizes[j] >= 0.3:
            into.given += 1
            into.right += any(overlap(i, j) for i in range(len(runs)))
    true_corners = []
    for i, (wall, _) in enumerate(runs):
        k = (i + 1) % len(runs)
        after = runs[k][0]
        if counted[i] and counted[k] and wall != after:
            for p in (scan.walls[wall, :2], scan.walls[wall, 2:]):
                for q in (scan.walls[after, :2], scan.walls[after, 2:]):
                    if np.allclose(p, q, atol=1e-9):
                        true_corners.append(p)
    vertices = np.vstack([scan.walls[:, :2], scan.walls[:, 2:]])
    reach = 0.1 + 3 * sigma_range
    into.corners_there += len(true_corners)
    into.corners_given += len(corners)
    for point in corners.position:
        near = np.hypot(*(vertices - point).T)
        into.corners_right += bool(near.min() < reach)
    for true in true_corners:
        if len(corners):
            near = np.hypot(*(corners.position - true).T)
            if near.min() < reach:
                into.corners_found += 1
                error = corners.position[near.argmin()] - true
                into.corner_nees.append(float(error @ np.linalg.solve(corners.covariance[near.argmin()], error)))


@pytest.fixture(name="simulate")
def simulate_fixture() -> Callable[..., Scan]:
    return simulate


@pytest.fixture
def score_rooms() -> Callable[..., Score]:
    """Score an extractor on `scans` rooms, half of them small and half large."""

    def run(extractor: Extractor, scans: int, **noise: float) -> Score:
        total = Score()
        for i in range(scans):
            beams, size = ((1112, (5.0, 3.0)), (884, (12.0, 8.0)))[i % 2]
            scan = simulate(5000 + i, beams=beams, size=size, **noise)
            score(scan, extractor.extract(scan.ranges, scan.angles), total, noise["sigma_range"])
        return total

    return run
