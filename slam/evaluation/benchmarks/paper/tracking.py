"""Test if tracking with a threshold of 20 mm works with a range noise of 5 cm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from features import Extractor, Features, Noise

from ....geometry.segments import Integers
from .environments import PAPER_NOISE, Environment

RANGE_SIGMAS = (0.001, 0.002, 0.005, 0.007, 0.010, 0.020, 0.050)
"""Tested standard deviations of range, metres; the last is the paper's."""
BEARINGS = (0.0, PAPER_NOISE.sigma_bearing)
"""Tested standard deviations of bearing, radians: none, and the paper's."""
TRACKING_SWEEPS = 20
"""Per environment and noise level."""
METHODS: tuple[Literal["tracking", "split"], ...] = ("tracking", "split")
"""The paper's segmentation and this project's."""
MIN_RAYS, MIN_LENGTH = 10, 0.3
"""Rays and metres of a straight wall that should be found."""
MIN_LINE_OVERLAP = 0.5
"""Common rays / all rays of a wall and an extracted line, from which the wall counts as found."""
MAX_CORNER_DISTANCE, CORNER_SIGMAS = 0.10, 3.0
"""Largest distance of a found corner: metres, plus a multiple of the range noise."""


def measure(environments: Sequence[Environment], seed: int, sweeps: int = TRACKING_SWEEPS) -> list[dict[str, Any]]:
    """Return the shares of walls and corners found for each noise level and method.

    Both methods are given the noise; the threshold of tracking is the paper's. A corner counts if both walls do.
    """
    rows = []
    for sigma_bearing in BEARINGS:
        for sigma_range in RANGE_SIGMAS:
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
    """Return the numbers of found walls, all walls, found corners and all corners."""
    counting = [counts_as_wall(environment, k) for k in range(len(environment.segments))]
    walls = [set(s.rays.tolist()) for s, counts in zip(environment.segments, counting, strict=True) if counts]
    beams = len(environment.angles)
    lines = [_beams(first, last, beams) for first, last in zip(found.lines.first, found.lines.last, strict=True)]
    matched = sum(any(_overlap(wall, line) >= MIN_LINE_OVERLAP for line in lines) for wall in walls)
    known = environment.positions[[counting[before] and counting[after] for before, after in environment.corners]]
    distances = np.linalg.norm(known[:, None] - found.corners.position, axis=2)
    near = distances.min(axis=1, initial=np.inf) <= MAX_CORNER_DISTANCE + CORNER_SIGMAS * noise.sigma_range
    return np.array([matched, len(walls), int(near.sum()), len(known)])


def counts_as_wall(environment: Environment, segment: int) -> bool:
    """Return True if a segment is straight and observed well enough to be found."""
    rays, wall = environment.segments[segment].rays, environment.segments[segment].wall
    return wall >= 0 and len(rays) >= MIN_RAYS and _length(environment, rays) >= MIN_LENGTH


def _length(environment: Environment, rays: Integers) -> float:
    ends = environment.ranges[rays[[0, -1]]] * np.exp(1j * environment.angles[rays[[0, -1]]])
    return float(abs(ends[1] - ends[0]))


def _beams(first: int, last: int, beams: int) -> set[int]:
    return {k % beams for k in range(first, last + 1 + (beams if last < first else 0))}


def _overlap(one: set[int], other: set[int]) -> float:
    return len(one & other) / len(one | other)


def largest_usable(rows: Sequence[dict[str, Any]], sigma_bearing: float, share: float = 0.9) -> float:
    """Return the largest range noise, metres, up to which tracking finds this share of the walls; 0 if none."""
    largest = 0.0
    for row in rows:
        if row["sigma_bearing"] == sigma_bearing:
            if row["tracking"]["walls"] < share:
                break
            largest = row["sigma_range"]
    return largest
