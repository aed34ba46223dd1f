"""Rooms to scan, and how well they are found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from features import Extractor, Noise
from features.benchmark.rooms import RoomScan, simulate
from features.benchmark.scoring import Score


def scan_room(
    seed: int, *, sigma_range: float = 0.01, sigma_bearing: float = np.radians(0.05), **options: float
) -> RoomScan:
    """A scan from within a room, seeded, of the smaller size where not told otherwise."""
    number = int(options.pop("number", 0))
    return simulate(np.random.default_rng(seed), Noise(sigma_range, sigma_bearing), number=number, **options)


@pytest.fixture(name="simulate")
def simulate_fixture() -> Callable[..., RoomScan]:
    return scan_room


@pytest.fixture
def score_rooms() -> Callable[..., Score]:
    """Score an extractor on `scans` rooms, half of them small and half large."""

    def run(extractor: Extractor, scans: int, **noise: float) -> Score:
        total = Score()
        for i in range(scans):
            scan = scan_room(5000 + i, number=i, **noise)
            total.add(scan, extractor.extract(scan.ranges, scan.angles), noise["sigma_range"])
        return total

    return run
