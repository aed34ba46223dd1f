"""Fixtures that simulate scans of rooms and score an extractor on them."""

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
    """Simulate a scan in a room; of the smaller size by default."""
    number = int(options.pop("number", 0))
    return simulate(np.random.default_rng(seed), Noise(sigma_range, sigma_bearing), number=number, **options)


@pytest.fixture(name="simulate")
def simulate_fixture() -> Callable[..., RoomScan]:
    return scan_room


@pytest.fixture
def score_rooms() -> Callable[..., Score]:
    """Return a function that scores an extractor on `scans` rooms, alternately small and large."""

    def run(extractor: Extractor, scans: int, **noise: float) -> Score:
        total = Score()
        for i in range(scans):
            scan = scan_room(5000 + i, number=i, **noise)
            total.add(scan, extractor.extract(scan.ranges, scan.angles), noise["sigma_range"])
        return total

    return run
