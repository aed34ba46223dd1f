"""Stray points of an LD06 are recognised by their intensity and their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.lidars.measurements import NO_QUALITY, SAMPLE, StructuredArray
from drivers.lidars.revolutions import make_scan
from drivers.lidars.stray_points import find_stray_points

BEAMS = 450


def revolution(range_: float = 3.0, quality: int = 200) -> StructuredArray:
    """Return the samples of one revolution in a round room."""
    samples = np.zeros(BEAMS, dtype=SAMPLE)
    samples["angle"] = -np.linspace(0.0, 2.0 * np.pi, BEAMS, endpoint=False)
    samples["range"], samples["quality"] = range_, quality
    return samples


@pytest.mark.parametrize(
    ("count", "quality", "strays"),
    [(1, 100, 1), (2, 219, 2), (2, 221, 0), (3, 100, 0), (3, 15, 3), (15, 10, 15), (16, 10, 0)],
)
@pytest.mark.parametrize("first", [200, BEAMS - 1])
def test_small_groups_are_strays_if_they_are_weak(count: int, quality: int, strays: int, first: int) -> None:
    samples = revolution()
    group = (first + np.arange(count)) % BEAMS
    samples["range"][group], samples["quality"][group] = 1.0, quality
    found = find_stray_points(samples)
    assert np.count_nonzero(found) == strays
    assert set(np.flatnonzero(found)) <= set(group)


def test_distant_points_and_no_returns_are_no_strays() -> None:
    samples = revolution(range_=8.0, quality=5)
    samples["range"][::3] = np.nan
    assert not find_stray_points(samples).any()
    assert not find_stray_points(samples[:0]).any()


def test_a_whole_circle_is_one_group() -> None:
    assert not find_stray_points(revolution(quality=5)).any()


def test_a_scan_has_the_intensities_of_its_beams() -> None:
    samples = revolution()
    samples["quality"] = np.arange(BEAMS) % 250
    scan = make_scan(samples, np.linspace(0.0, 0.1, BEAMS), 0.1, 12.0)
    assert scan.intensities is not None
    np.testing.assert_array_equal(
        scan.intensities, samples["quality"][::-1]
    )  # angles increase, the lidar turns clockwise
    samples["quality"] = NO_QUALITY
    assert make_scan(samples, np.linspace(0.0, 0.1, BEAMS), 0.1, 12.0).intensities is None
