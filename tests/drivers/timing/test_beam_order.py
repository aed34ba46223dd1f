"""The times of the beams are decided from the scans of a turning robot, and only if they show them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Odometry, Scan, with_reversed_times
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from drivers.source_factory import LidarSelection
from drivers.timing.beam_order import decide_beam_order
from drivers.timing.beam_times import STATED, BeamTimes, set_beam_times
from drivers.timing.turns import Turns
from slam.io.recording_timing import RecordingTiming

from ...recordings import dataset_file
from .drives import mirrored, office_drive

RATE = LIDAR_MODELS["short"].rate
"""Turns per second of the lidar in `office_drive`."""


def with_reversed_scans(drive: tuple[Message, ...]) -> list[Message]:
    return [with_reversed_times(message) if isinstance(message, Scan) else message for message in drive]


@pytest.mark.parametrize("clockwise", [False, True])
def test_order_is_found_for_both_directions_of_rotation(clockwise: bool) -> None:
    drive = mirrored(office_drive()) if clockwise else office_drive()
    assert decide_beam_order(Turns(drive)).times == STATED
    assert decide_beam_order(Turns(with_reversed_scans(drive))).times == BeamTimes(reversed=True)


def test_order_is_found_without_odometry() -> None:
    scans = tuple(message for message in office_drive() if isinstance(message, Scan))
    assert decide_beam_order(Turns(scans)).times == STATED
    assert decide_beam_order(Turns(with_reversed_scans(scans))).times == BeamTimes(reversed=True)


def with_offsets(drive: Iterable[Message], sweep: float) -> list[Message]:
    """Return the drive with scans that state another duration of the sweep, in seconds."""
    return [
        replace(message, time_offsets=np.linspace(0.0, sweep, len(message.ranges)))
        if isinstance(message, Scan) else message
        for message in drive
    ]  # fmt: skip


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("stated", [0.0, pytest.param(1e-4, marks=pytest.mark.slow)])
def test_a_lidar_that_turns_is_recognised_if_no_times_or_those_of_a_buffer_are_stated(
    clockwise: bool, stated: float
) -> None:
    drive = with_offsets(mirrored(office_drive()) if clockwise else office_drive(), stated)
    for messages in (drive, [message for message in drive if isinstance(message, Scan)]):
        found = decide_beam_order(Turns(messages)).times
        assert found is not None
        assert found.reversed == clockwise
        assert found.turn == pytest.approx(1.0 / RATE, rel=1e-3)


@pytest.mark.parametrize(
    ("sweep", "is_doubtful"),
    [(1e-4, True), (0.05 / RATE, True), (0.2 / RATE, False), (1.0 / RATE, False), (30.0 / RATE, True)],
)
def test_stated_times_that_do_not_fit_the_period_are_doubtful_if_the_scans_do_not_decide(
    sweep: float, is_doubtful: bool
) -> None:
    end = office_drive()[0].stamp + 2.0  # too few scans to decide anything
    test = decide_beam_order(Turns(with_offsets([one for one in office_drive() if one.stamp < end], sweep)))
    assert test.times is None
    doubts = RecordingTiming(order_test=test).doubts()
    assert len(doubts) == is_doubtful
    assert all(f"set lidar.turn_period={1.0 / RATE:.3g}, and" in text for text in doubts)


def drive_with_scans_of_one_moment() -> list[Message]:
    """Return a drive with a lidar that turns ten times as fast, of whose scans every tenth is kept, without times."""
    lidar = replace(LIDAR_MODELS["short"], rate=10 * RATE)
    drive = list(Simulation("office", 0, 30.0, lidar, WHEEL_MODELS["good"], [0.1, 0.0, 0.0]))
    scans = [message for message in drive if isinstance(message, Scan)][::10]
    odometry = [message for message in drive if isinstance(message, Odometry)]
    return with_offsets(sorted([*scans, *odometry], key=lambda message: message.stamp), 0.0)


@pytest.mark.slow
def test_scans_of_one_moment_are_recognised() -> None:
    drive = drive_with_scans_of_one_moment()
    assert decide_beam_order(Turns(drive)).times == STATED
    assert decide_beam_order(Turns(with_offsets(drive, 1.0 / RATE))).times == BeamTimes(0.0)


def test_odometry_that_begins_late_finds_the_turns() -> None:
    drive = office_drive()
    late = [message for message in drive if isinstance(message, Scan) or message.stamp > drive[0].stamp + 15.0]
    first = next(message.stamp for message in late if isinstance(message, Odometry))
    runs = Turns(late).runs
    assert runs
    assert all(run.scans[-1].stamp > first for run in runs)


def test_nothing_is_said_of_a_robot_that_does_not_turn() -> None:
    scans = [message for message in office_drive() if isinstance(message, Scan)]
    assert decide_beam_order(Turns(replace(scans[0], stamp=scan.stamp) for scan in scans)).times is None
    assert decide_beam_order(Turns(drivers.open("sim:corridor?duration=15&lidar=short"))).times is None
    assert decide_beam_order(Turns([])).times is None


def test_a_turn_lasts_its_time_also_for_part_of_the_view() -> None:
    half = Scan(0.0, np.ones(91), np.radians(np.linspace(-45.0, 45.0, 91)), np.zeros(91), 0.1, 10.0)
    offsets = BeamTimes(0.2).of(half).time_offsets
    np.testing.assert_allclose(offsets, np.linspace(0.0, 0.05, 91), atol=1e-12)
    np.testing.assert_allclose(BeamTimes(0.2, reversed=True).of(half).time_offsets, offsets[::-1], atol=1e-12)
    assert STATED.of(half) is half


def test_reversed_times_cover_the_same_sweep() -> None:
    scan = next(message for message in office_drive() if isinstance(message, Scan))
    other = with_reversed_times(scan)
    np.testing.assert_allclose(other.time_offsets, scan.time_offsets[::-1], atol=1e-12)
    np.testing.assert_allclose(with_reversed_times(other).time_offsets, scan.time_offsets, atol=1e-12)


def test_set_times_are_those_of_the_settings() -> None:
    assert set_beam_times("auto", None) is None
    assert set_beam_times("forward", None) == STATED
    assert set_beam_times("auto", 0.2) == set_beam_times("forward", 0.2) == BeamTimes(0.2)
    assert set_beam_times("reversed", 0.2) == BeamTimes(0.2, reversed=True)


def offsets_of(path: Path, order: str) -> np.ndarray:
    scan = next(message for message in drivers.open(path, order) if isinstance(message, Scan))
    return scan.time_offsets


def test_recording_is_corrected_unless_an_order_is_set(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        for message in with_reversed_scans(office_drive()):
            writer.write(message)
    stated = offsets_of(path, "forward")
    assert stated[0] > stated[-1]
    for order in ("auto", "reversed"):
        corrected = offsets_of(path, order)
        np.testing.assert_allclose(corrected, stated[::-1], atol=1e-9)
    report = drivers.open(path).report
    assert report.skipped == 0


def test_a_recording_that_states_no_times_is_read_with_those_of_a_turn(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        for message in with_offsets(office_drive(), 0.0):
            writer.write(message)
    assert offsets_of(path, "auto")[-1] == pytest.approx(1.0 / RATE, rel=0.01)
    assert not offsets_of(path, "forward").any()
    (correction,) = RecordingTiming.of(drivers.open(path)).corrections()
    text = "beams measured over counter-clockwise turns of 0.182 s though no times are stated, by "
    assert correction.startswith(text)


def carmen_log(path: Path, drive: Iterable[Message]) -> Path:
    """Write the scans of a drive, each with the latest odometry, as CARMEN log, which has one stamp for a scan: here
    that of the middle of its sweep.
    """
    lines, pose = [], np.zeros(3)
    for message in drive:
        if isinstance(message, Odometry):
            pose = message.pose
        elif isinstance(message, Scan):
            step = float(message.angles[1] - message.angles[0])
            ranges = np.nan_to_num(message.ranges, nan=80.0).tolist()
            beams = f"{float(message.angles[0])!r} {step * len(ranges)!r} {step!r} 80 0.01 0 {len(ranges)}"
            poses = f"0 0 0 {' '.join(map(repr, pose.tolist()))} 0 0 0 0 0"
            stamp = message.stamp + 0.5 * message.duration
            lines.append(f"ROBOTLASER1 0 {beams} {' '.join(map(repr, ranges))} 0 {poses} {stamp!r} host 0\n")
    path.write_text("".join(lines))
    return path


def test_a_format_without_a_place_for_times_is_read_with_those_of_a_turn(tmp_path: Path) -> None:
    drive = office_drive()
    path = carmen_log(tmp_path / "drive.clf", drive)
    read, as_stated = list(drivers.open(path)), list(drivers.open(path, "forward"))
    assert len(read) == len(as_stated)
    assert [message.stamp for message in read] == sorted(message.stamp for message in read)
    measured, found, stated = (
        [message for message in messages if isinstance(message, Scan)] for messages in (drive, read, as_stated)
    )
    for true, scan, unchanged in zip(measured, found, stated, strict=True):
        assert scan.stamp == pytest.approx(true.stamp, abs=1e-3)
        np.testing.assert_allclose(scan.time_offsets, true.time_offsets, atol=1e-3)
        assert unchanged.stamp == pytest.approx(true.stamp + 0.5 * true.duration, abs=1e-6)
        assert not unchanged.time_offsets.any()


def test_a_set_turn_of_a_format_without_a_place_for_times_is_around_the_stamp(tmp_path: Path) -> None:
    path = carmen_log(tmp_path / "drive.clf", office_drive())
    turned = next(
        message for message in drivers.open(path, LidarSelection(turn_period=0.1)) if isinstance(message, Scan)
    )
    stated = next(message for message in drivers.open(path, "forward") if isinstance(message, Scan))
    assert turned.stamp == pytest.approx(stated.stamp - 0.5 * turned.duration)
    assert turned.duration == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize(
    ("name", "turn"),
    [
        ("mines/mines-1.clf", 0.098),
        pytest.param("mines/mines-3.clf", 0.098, marks=pytest.mark.slow),  # of the same lidar
        ("lego/lego.clf", 0.233),
    ],
)
def test_a_rotating_lidar_of_a_public_log_is_recognised(name: str, turn: float) -> None:
    reader = drivers.source_factory.recording_of(drivers.open(dataset_file(name)))
    assert reader is not None
    times = reader.beam_times
    assert times.turn == pytest.approx(turn, abs=1e-3)
    assert not times.reversed
    assert times.centred


def test_public_recording_with_reversed_times_is_recognised() -> None:
    reader = drivers.source_factory.recording_of(drivers.open(dataset_file("turtlebot4/bag")))
    assert reader is not None
    assert reader.beam_times == BeamTimes(reversed=True)
