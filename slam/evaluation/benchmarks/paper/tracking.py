"""Whether tracking with a threshold of 20 mm can go with ranges whose standard deviation is 5 cm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from features import Extractor, Features, Noise
from features.types import Integers

from .environments import PAPER_NOISE, Environment

SIGMAS = (0.001, 0.002, 0.005, 0.007, 0.010, 0.020, 0.050)
"""Standard deviations of range to try, metres; the last is the paper's."""
BEARINGS = (0.0, PAPER_NOISE.sigma_bearing)
"""And of bearing, radians: none, and the paper's."""
SWEEPS = 20
"""Sweeps of each environment with each noise."""
METHODS: tuple[Literal["tracking", "split"], ...] = ("tracking", "split")
"""The paper's segmentation and the product's."""
FEWEST_RAYS, SHORTEST = 10, 0.3
"""Rays and metres from which on a straight wall counts as one to be found."""
OVERLAP = 0.5
"""Of the rays of a wall and of a line found, the share that both have, from which on the wall is found."""
NEAR, NEAR_SIGMAS = 0.10, 3.0
"""Metres, and standard deviations of range besides, within which a corner is found."""


def measure(environments: Sequence[Environment], seed: int, sweeps: int = SWEEPS) -> list[dict[str, Any]]:
    """For each noise and method: the shares of walls and of corners found.

    Either method knows the noise; the threshold of tracking is the paper's. Corners count where both walls do.
    """
    rows = []
    for sigma_bearing in BEARINGS:
        for sigma_range in SIGMAS:
            noise = Noise(sigma_range, sigma_bearing)
            row: dict[str, Any] = {"sigma_range": sigma_range, "sigma_bearing": sigma_bearing}
            for method in METHODS:
                random = np.random.default_rng(seed)
                counts = np.zeros(4, dtype=np.int64)
                for environment in environments:
                    extractor = Extractor(noise, method=method, adapt_noise=False)
                    for _ in range(sweeps):
                        found = extractor.extract(environment.sweep(random, noise), environment.angles)
                        counts += score(environment, found, noise)
                walls, known_walls, corners, known_corners = counts.tolist()
                row[method] = {"walls": walls / known_walls, "corners": corners / known_corners}
            rows.append(row)
    return rows


def score(environment: Environment, found: Features, noise: Noise) -> Integers:
    """Walls found, walls there, corners found, corners there."""
    counting = [counts_as_wall(environment, k) for k in range(len(environment.segments))]
    walls = [set(s.rays.tolist()) for s, counts in zip(environment.segments, counting, strict=True) if counts]
    beams = len(environment.angles)
    lines = [_beams(first, last, beams) for first, last in zip(found.lines.first, found.lines.last, strict=True)]
    matched = sum(any(_overlap(wall, line) >= OVERLAP for line in lines) for wall in walls)
    known = environment.positions[[counting[before] and counting[after] for before, after in environment.corners]]
    distances = np.linalg.norm(known[:, None] - found.corners.position, axis=2)
    near = distances.min(axis=1, initial=np.inf) <= NEAR + NEAR_SIGMAS * noise.sigma_range
    return np.array([matched, len(walls), int(near.sum()), len(known)])


def counts_as_wall(environment: Environment, segment: int) -> bool:
    """Whether a segment is straight, and seen well enough to be asked for."""
    rays, wall = environment.segments[segment].rays, environment.segments[segment].wall
    return wall >= 0 and len(rays) >= FEWEST_RAYS and _length(environment, rays) >= SHORTEST


def _length(environment: Environment, rays: Integers) -> float:
    ends = environment.ranges[rays[[0, -1]]] * np.exp(1j * environment.angles[rays[[0, -1]]])
    return float(abs(ends[1] - ends[0]))


def _beams(first: int, last: int, beams: int) -> set[int]:
    return {k % beams for k in range(first, last + 1 + (beams if last < first else 0))}


def _overlap(one: set[int], other: set[int]) -> float:
    return len(one & other) / len(one | other)


def largest_usable(rows: Sequence[dict[str, Any]], sigma_bearing: float, share: float = 0.9) -> float:
    """The largest standard deviation of range, metres, up to which tracking finds so many of the walls; 0: none."""
    largest = 0.0
    for row in rows:
        if row["sigma_bearing"] == sigma_bearing:
            if row["tracking"]["walls"] < share:
                break
            largest = row["sigma_range"]
    return largest
