"""Summary of a recording and the warnings about its problems."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, RecordingInfo, Scan, SourceReport, inspect


class ListSource:
    """Source of messages from a list."""

    name = "listed"

    def __init__(self, messages: list[Message]) -> None:
        self.messages, self.report = messages, SourceReport()

    def __iter__(self) -> Iterator[Message]:
        return iter(self.messages)

    def __len__(self) -> int:
        return len(self.messages)


def scan(stamp: float, beams: int = 4, valid: int = 4, offset: float = 0.0, mounted: bool = True) -> Scan:
    ranges = np.where(np.arange(beams) < valid, 1.0, np.nan)
    mount = np.zeros(3) if mounted else None
    return Scan(stamp, ranges, np.linspace(-1, 1, beams), np.full(beams, offset), 0.1, 10.0, mount)


def odometry(stamp: float, x: float = 0.0) -> Odometry:
    return Odometry(stamp, np.array([x, 0.0, 0.0]))


def drive(until: float = 10.0) -> list[Message]:
    messages: list[Message] = [odometry(0.1 * i, 0.05 * i) for i in range(round(until * 10) + 1)]
    messages += [scan(0.05 + 0.1 * i) for i in range(round(until * 10))]
    return sorted(messages, key=lambda message: message.stamp)


def inspect_list(messages: list[Message]) -> RecordingInfo:
    return inspect(ListSource(messages))


def test_good_recording_is_described_without_warnings() -> None:
    info = inspect_list(drive())
    assert (info.scans, info.odometry, info.ground_truth) == (100, 101, 0)
    assert info.duration == pytest.approx(10.0)
    assert info.scan_rate == pytest.approx(10.0)
    assert info.odometry_rate == pytest.approx(10.0)
    assert info.beams == (4, 4)
    assert info.ranges == (1.0, 1.0)
    assert info.range_limits == (0.1, 10.0)
    assert info.path_length == pytest.approx(5.0)
    assert info.mounts == [(0.0, 0.0, 0.0)]
    assert info.warnings == []


@pytest.mark.parametrize(
    ("messages", "warning"),
    [
        ([odometry(0.1 * i) for i in range(9)], "no scans"),
        ([scan(0.1 * i) for i in range(9)], "no odometry: the motion comes from the scans alone"),
        ([*drive(), scan(10.1, mounted=False)], "1 scan without a lidar mount"),
        ([scan(0.1 * i, valid=1) for i in range(9)], "75 % of the beams"),
        ([*drive(), *[scan(30.0 + 0.1 * i) for i in range(9)]], "1 gap in the scans, the longest 20.0 s"),
        ([*drive(), *[scan(10.1 + 0.1 * i) for i in range(50)]], "scans without odometry for 5.0 s at 0:10"),
        ([*[scan(-3.0 + 0.1 * i) for i in range(29)], *drive()], "scans without odometry for 3.0 s at 0:00"),
        (
            [*drive(), *[odometry(10.1 + 0.1 * i, 5.0 + 0.05 * i) for i in range(60)]],
            "odometry without scans for 6.0 s at 0:09, in which the robot drives 3.0 m",
        ),
        (
            [*[odometry(-4.0 + 0.1 * i, 0.05 * i - 2.0) for i in range(40)], *drive()],
            "odometry without scans for 4.0 s at 0:00, in which the robot drives 2.0 m",
        ),
        ([*drive(), odometry(10.1, x=50.0)], "1 jump of the odometry"),
        ([odometry(0.1 * i, x=40.0 * i) for i in range(50)], "is it in millimetres or degrees?"),
        ([scan(0.1 * i, offset=0.5) for i in range(9)], "longer than a revolution"),
        ([scan(0.1 * i, offset=-0.5) for i in range(9)], "before their scan's stamp"),
    ],
)
def test_problems_are_warned_of(messages: list[Message], warning: str) -> None:
    assert any(warning in line for line in inspect_list(messages).warnings), inspect_list(messages).warnings


def test_a_number_of_beams_that_varies_is_normal() -> None:
    info = inspect_list([*drive(), scan(10.1, beams=6)])
    assert (info.beams, info.warnings) == ((4, 6), [])


def test_single_slow_revolutions_are_not_warned_of() -> None:
    info = inspect_list([*drive(), scan(10.1, offset=0.5)])
    assert info.warnings == []


@pytest.mark.parametrize(("step", "clause"), [(1.0, ", and all are whole seconds"), (0.4, "")])
def test_stamps_coarser_than_scans_are_frequent_are_warned_of(step: float, clause: str) -> None:
    coarse = [scan(step * math.floor(m.stamp / step)) if isinstance(m, Scan) else m for m in drive()]
    info = inspect_list(coarse)
    share = 100.0 - 1000.0 / (99.0 * step)
    (warning,) = [text for text in info.warnings if "coarser" in text]
    assert warning.endswith(f"have the stamp of the scan before{clause}: stamps are coarser than scans are frequent")
    assert float(warning.split()[0]) == pytest.approx(share, abs=3.0)
    assert info.scan_rate == pytest.approx(10.0, rel=0.12)


def test_rates_are_the_mean_outside_of_gaps() -> None:
    bursts = [odometry(t + dt) for t in np.arange(0.0, 10.0, 0.3) for dt in (0.0, 1e-4, 2e-4)]
    messages = [*bursts, *(odometry(20.0 + 0.3 * k + dt) for k in range(30) for dt in (0.0, 1e-4, 2e-4))]
    info = inspect_list([*messages])
    assert info.odometry_rate == pytest.approx(10.0, abs=0.3)


def test_scans_in_a_gap_of_the_odometry_are_warned_of() -> None:
    messages = [m for m in drive(20.0) if isinstance(m, Scan) or not 5.0 < m.stamp < 14.9]
    warnings = inspect_list(messages).warnings
    assert any("scans without odometry for" in warning and "at 0:05" in warning for warning in warnings)


def test_jumps_are_not_part_of_the_path_length() -> None:
    info = inspect_list([*drive(), odometry(10.1, x=50.0)])
    assert info.path_length == pytest.approx(5.0)
    assert info.odometry_jumps == [10.1]


@pytest.mark.parametrize("kind", ["carmen", "mcap", "ros1-bag", "simulation"])
def test_every_source_can_be_inspected(recordings: dict[str, str], kind: str) -> None:
    info = inspect(drivers.open(recordings[kind]))
    assert info.scans == 29
    assert info.report.messages == info.scans + info.odometry + info.ground_truth
    assert info.warnings == []
