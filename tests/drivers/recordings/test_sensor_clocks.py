"""Sensors of one recording whose computers have different clocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, Scan
from drivers.recordings.ros_encoder import RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, ODOMETRY, TRANSFORMS
from drivers.timestamps import to_nanoseconds

Stored = tuple[str, str, int, bytes]
WriteBag = Callable[[Path, list[Stored]], Path]
START = 1.7e9
"""Seconds since 1970 at which the drive begins by the recorder's clock."""


@pytest.fixture(params=["a.bag", "sqlite3", "mcap"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return tmp_path / str(request.param)


def entries(
    messages: Iterable[Message],
    lidar: float = 0.0,
    base: Callable[[float], float] = lambda stamp: 0.0,
    transforms: bool = False,
    frame: str = "laser",
) -> list[Stored]:
    """Return messages as they are recorded, 10 ms after they were measured.

    lidar  seconds by which the clock of the lidar is ahead of the recorder's
    base   the same of the base, which may depend on the time
    """
    encoder, stored = RosEncoder(), []
    for message in messages:
        received = to_nanoseconds(START + message.stamp + 0.01)
        if isinstance(message, Scan):
            scan = replace(message, stamp=START + message.stamp + lidar)
            stored.append(("/scan", LASER_SCAN, received, encoder.scan(scan, frame)))
        elif isinstance(message, Odometry):
            stamp = START + message.stamp + base(message.stamp)
            if transforms:
                data = encoder.transform(stamp, "odom", "base_link", message.pose)
                stored.append(("/tf", TRANSFORMS, received, data))
            else:
                stored.append(("/odom", ODOMETRY, received, encoder.odometry(replace(message, stamp=stamp))))
    return stored


def odometry_of(messages: Iterable[Message]) -> list[Odometry]:
    return [message for message in messages if isinstance(message, Odometry)]


def scans_of(messages: Iterable[Message]) -> list[Scan]:
    return [message for message in messages if isinstance(message, Scan)]


@pytest.mark.parametrize("ahead", [-1.6e9, -600000.0, 30.0])
@pytest.mark.parametrize("transforms", [False, True])
def test_odometry_is_moved_onto_the_clock_of_the_scans(
    path: Path, drive: list[Message], write_bag: WriteBag, ahead: float, transforms: bool
) -> None:
    """A computer without a battery begins in 1970 or where it stopped, or was never set exactly."""
    source = drivers.open(write_bag(path, entries(drive, base=lambda stamp: ahead, transforms=transforms)))
    messages = list(source)
    assert [scan.stamp - START for scan in scans_of(messages)] == pytest.approx(
        [scan.stamp for scan in scans_of(drive)], abs=1e-5
    )
    assert [reading.stamp - START for reading in odometry_of(messages)] == pytest.approx(
        [reading.stamp for reading in odometry_of(drive)], abs=1e-5
    )
    topic = "/tf" if transforms else "/odom"
    moved = f"stamps of {topic} moved by {-ahead:.3f} s: its clock is not that of the scans"
    assert moved in source.report.interpretations
    assert not source.report.skipped


def test_transforms_of_another_computer_are_no_odometry(path: Path, drive: list[Message], write_bag: WriteBag) -> None:
    """A program on another computer publishes where the robot is in a map, on the topic of odometry's transforms."""
    data = RosEncoder().transform(START - 600000.0, "map", "odom", np.zeros(3))
    localisation = [("/tf", TRANSFORMS, entry[2] + 1, data) for entry in entries(scans_of(drive))]
    both = sorted([*entries(drive, transforms=True), *localisation], key=lambda entry: entry[2])
    source = drivers.open(write_bag(path, both))
    assert [reading.stamp - START for reading in odometry_of(source)] == pytest.approx(
        [reading.stamp for reading in odometry_of(drive)], abs=1e-5
    )
    assert not [text for text in source.report.interpretations if "clock" in text]


def test_a_common_clock_that_is_wrong_is_kept(path: Path, drive: list[Message], write_bag: WriteBag) -> None:
    source = drivers.open(write_bag(path, entries(drive, lidar=-600000.0, base=lambda stamp: -600000.0)))
    messages = list(source)
    assert odometry_of(messages)[0].stamp == pytest.approx(START - 600000.0 + odometry_of(drive)[0].stamp, abs=1e-5)
    assert not [text for text in source.report.interpretations if "clock" in text]


def test_odometry_that_is_received_late_is_on_the_same_clock(
    tmp_path: Path, drive: list[Message], write_bag: WriteBag
) -> None:
    """A radio link stalls: what was measured in 26 s of the drive arrives at once."""
    slow = [replace(message, stamp=20.0 * message.stamp) for message in drive]
    begin, end = to_nanoseconds(START + 4.0), to_nanoseconds(START + 30.0)
    late = [
        (topic, kind, end if kind == ODOMETRY and begin < received < end else received, data)
        for topic, kind, received, data in entries(slow)
    ]
    source = drivers.open(write_bag(tmp_path / "sqlite3", sorted(late, key=lambda entry: entry[2])))
    assert [reading.stamp - START for reading in odometry_of(source)] == pytest.approx(
        [reading.stamp for reading in odometry_of(slow)], abs=1e-5
    )
    assert not source.report.interpretations


def test_scans_of_a_simulator_on_the_topic_of_a_lidar_are_left_out(
    path: Path, drive: list[Message], write_bag: WriteBag
) -> None:
    """A simulator that was left running published scans without returns on the same topic, from zero on."""
    empty = [replace(scan, ranges=np.full(len(scan.ranges), np.nan)) for scan in scans_of(drive)]
    simulated = entries(empty, lidar=700.0 - START, frame="simulated_laser")
    both = sorted([*entries(scans_of(drive)), *simulated], key=lambda entry: entry[2])
    source = drivers.open(write_bag(path, both))
    scans = scans_of(source)
    assert [scan.stamp - START for scan in scans] == pytest.approx([scan.stamp for scan in scans_of(drive)], abs=1e-5)
    (reason,) = source.report.interpretations
    assert reason.startswith("scans of /scan with the frame laser:")
    assert "left out, since they have another clock: simulated_laser:" in reason


@pytest.mark.parametrize("transforms", [False, True])
@pytest.mark.parametrize("live_odometry", [False, True])
def test_of_a_lidar_and_a_replayed_recording_on_one_topic_one_is_read(
    path: Path, drive: list[Message], write_bag: WriteBag, transforms: bool, live_odometry: bool
) -> None:
    """Both have the same frames. If only the recording has odometry, its scans are read, though it is shorter."""
    earlier, begin = -600000.0, drive[0].stamp + 1.0
    played = [message for message in drive if message.stamp > begin]
    replayed = entries(played, earlier, lambda stamp: earlier, transforms)
    shifted = [replace(message, stamp=message.stamp + 0.013) for message in drive]
    live = entries(shifted if live_odometry else scans_of(shifted), transforms=transforms)
    source = drivers.open(write_bag(path, sorted([*replayed, *live], key=lambda entry: entry[2])))
    messages = list(source)
    read, start = (shifted, START) if live_odometry else (played, START + earlier)
    for kept, expected in ((scans_of(messages), scans_of(read)), (odometry_of(messages), odometry_of(read))):
        assert [one.stamp - start for one in kept] == pytest.approx([one.stamp for one in expected], abs=1e-5)
    reasons = [text for text in source.report.interpretations if "several sources publish on" in text]
    assert len(reasons) == 1 + live_odometry
    assert any(
        text.startswith("several sources publish on /scan, as a lidar and a replayed recording do;") for text in reasons
    )
    assert f"stamped {-earlier:.1f} s {'earlier' if live_odometry else 'later'}:" in " ".join(reasons)
    assert not source.report.corrected
    assert not source.report.skipped


def test_a_clock_that_is_set_back_is_of_one_source(path: Path, drive: list[Message], write_bag: WriteBag) -> None:
    middle = 0.5 * (drive[0].stamp + drive[-1].stamp)
    first = entries(message for message in drive if message.stamp < middle)
    later = entries((message for message in drive if message.stamp >= middle), -600000.0, lambda stamp: -600000.0)
    source = drivers.open(write_bag(path, [*first, *later]))
    assert len(scans_of(source)) == len(scans_of(drive))
    assert not [text for text in source.report.interpretations if "sources" in text]


def test_two_lidars_of_one_clock_on_a_topic_are_both_read(
    path: Path, drive: list[Message], write_bag: WriteBag
) -> None:
    both = [*entries(scans_of(drive)), *entries(scans_of(drive), lidar=0.02, frame="rear")]
    source = drivers.open(write_bag(path, sorted(both, key=lambda entry: entry[2])))
    assert len(scans_of(source)) == 2 * len(scans_of(drive))
    assert not source.report.interpretations
