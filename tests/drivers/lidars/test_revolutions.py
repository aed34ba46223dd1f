"""Scans from measurements: order, times, gaps, completeness."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.lidars.measurements import NO_MEASUREMENTS, PACKET, SAMPLE, Measurements, to_counter_clockwise
from drivers.lidars.revolutions import MAX_SAMPLES, RevolutionAssembler, make_scan

RATE, BEAMS = 10.0, 360


def turning(first: float, last: float, begin: float = 0.5) -> tuple[Measurements, np.ndarray]:
    """Return measurements of a lidar that turns clockwise from `first` to `last` revolutions, and their stamps."""
    turns = np.arange(round(first * BEAMS), round(last * BEAMS)) / BEAMS
    samples = np.zeros(len(turns), SAMPLE)
    samples["angle"] = to_counter_clockwise(2 * np.pi * turns)
    samples["range"] = 1.0 + np.mod(turns, 1.0)
    samples["start"] = np.isclose(np.mod(turns, 1.0), 0.0)
    packets = np.zeros(1, PACKET)
    return Measurements(samples, packets), begin + turns / RATE


def without(measurements: Measurements, stamps: np.ndarray, keep: np.ndarray) -> tuple[Measurements, np.ndarray]:
    return Measurements(measurements.samples[keep], measurements.packets), stamps[keep]


def test_a_revolution_becomes_a_scan() -> None:
    assembler = RevolutionAssembler(0.1, 1.9, mount=np.array([0.1, 0.0, 0.2]))
    scans = assembler.add(*turning(0.4, 2.5))
    (scan,) = scans
    assert scan.stamp == pytest.approx(0.6)
    assert len(scan.angles) == BEAMS
    assert np.all(np.diff(scan.angles) > 0)
    assert scan.angles[-1] == pytest.approx(0.0, abs=1e-12)
    assert scan.angles[0] == pytest.approx(-2 * np.pi * (1 - 1 / BEAMS))
    np.testing.assert_allclose(scan.time_offsets, -scan.angles / (2 * np.pi) / RATE, atol=1e-9)
    expected = 1.0 - scan.angles / (2 * np.pi)
    np.testing.assert_allclose(scan.ranges, np.where(expected <= 1.9, expected, np.nan), atol=1e-9)
    assert (scan.range_min, scan.range_max) == (0.1, 1.9)
    assert scan.mount is not None
    assert assembler.counters.incomplete == 0


def test_upside_down_mirrors_the_angles() -> None:
    upright = RevolutionAssembler(0.1, 5.0).add(*turning(0, 1.1))[0]
    mirrored = RevolutionAssembler(0.1, 5.0, upside_down=True).add(*turning(0, 1.1))[0]
    np.testing.assert_allclose(mirrored.angles, -upright.angles[::-1])
    np.testing.assert_array_equal(mirrored.ranges, upright.ranges[::-1])
    assert np.all(np.diff(mirrored.time_offsets) > 0)


@settings(max_examples=30, deadline=None)
@given(cuts=st.lists(st.integers(0, 1500), max_size=12))
def test_scans_do_not_depend_on_how_measurements_are_split(cuts: list[int]) -> None:
    measurements, stamps = turning(0.2, 4.3)
    expected = RevolutionAssembler(0.1, 5.0).add(measurements, stamps)
    assembler, scans = RevolutionAssembler(0.1, 5.0), []
    edges = [0, *sorted(min(cut, len(stamps)) for cut in cuts), len(stamps)]
    for first, end in pairwise(edges):
        scans += assembler.add(*without(measurements, stamps, np.arange(first, end)))
    assert len(scans) == len(expected) == 3
    for one, other in zip(scans, expected, strict=True):
        assert one.stamp == other.stamp
        np.testing.assert_array_equal(one.angles, other.angles)
        np.testing.assert_array_equal(one.time_offsets, other.time_offsets)


def test_lost_packets_leave_a_gap() -> None:
    measurements, stamps = turning(0, 2.1)
    keep = (np.arange(len(stamps)) < 400) | (np.arange(len(stamps)) >= 440)
    assembler = RevolutionAssembler(0.1, 5.0)
    scans = assembler.add(*without(measurements, stamps, keep))
    assert [len(scan.ranges) for scan in scans] == [360, 320]
    assert assembler.counters.complete == 2


@pytest.mark.parametrize(
    ("first", "end"), [(400, 480), (360, 440), (650, 721), (300, 500), (300, 700), (370, 710), (340, 800)]
)
def test_too_large_a_gap_makes_a_revolution_incomplete(first: int, end: int) -> None:
    measurements, stamps = turning(0, 5.1)
    keep = (np.arange(len(stamps)) < first) | (np.arange(len(stamps)) >= end)
    assembler = RevolutionAssembler(0.1, 5.0)
    scans = assembler.add(*without(measurements, stamps, keep))
    assert assembler.counters.incomplete >= 1
    assert 2 <= len(scans) < 5
    for scan in scans:
        assert np.ptp(scan.angles) <= np.radians(361)
        assert scan.time_offsets.max() <= 0.11


def test_lost_start_makes_two_revolutions_incomplete() -> None:
    measurements, stamps = turning(0, 4.1)
    measurements.samples["start"][720] = False
    assembler = RevolutionAssembler(0.1, 5.0)
    assert len(assembler.add(measurements, stamps)) == 2
    assert assembler.counters.incomplete == 1


def test_one_wrong_angle_does_not_lose_a_revolution() -> None:
    measurements, stamps = turning(0, 1.1)
    measurements.samples["angle"][100] -= 2.5
    (scan,) = RevolutionAssembler(0.1, 5.0).add(measurements, stamps)
    assert np.all(np.diff(scan.angles) > 0)
    assert len(scan.ranges) >= BEAMS - 1


def test_of_beams_in_one_direction_the_one_with_a_return_is_kept() -> None:
    measurements, stamps = turning(0, 0.1)
    samples = measurements.samples
    samples["angle"][5] = samples["angle"][4]
    samples["range"][4] = np.nan
    scan = make_scan(samples, stamps, 0.1, 5.0)
    assert len(scan.ranges) == len(samples) - 1
    assert not np.isnan(scan.ranges).any()
    assert np.all(np.diff(scan.angles) > 0)


def test_memory_is_bounded_without_starts() -> None:
    measurements, stamps = turning(0, 20)
    measurements.samples["start"] = False
    assembler = RevolutionAssembler(0.1, 5.0)
    assert assembler.add(measurements, stamps) == []
    measurements.samples["start"][0] = True
    for _ in range(2 * MAX_SAMPLES // len(stamps)):
        assert assembler.add(measurements, stamps) == []
        measurements.samples["start"] = False
    assert assembler.counters.incomplete == 1


def test_no_measurements_give_no_scans() -> None:
    assembler = RevolutionAssembler(0.1, 5.0)
    assert assembler.add(NO_MEASUREMENTS, np.empty(0)) == []
    assert len(NO_MEASUREMENTS.stamps(np.empty(0))) == 0


def test_reset_discards_the_unfinished_revolution() -> None:
    assembler = RevolutionAssembler(0.1, 5.0)
    assembler.add(*turning(0, 0.5))
    assembler.reset()
    scans = assembler.add(*turning(0.7, 2.1, begin=100.0))
    assert [scan.stamp for scan in scans] == [pytest.approx(100.1)]
    assert assembler.counters.incomplete == 0
