"""Timing errors of a recording are corrected in a run, shown by `wclm info`, and can be set."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Scan, delay_odometry, with_reversed_times
from drivers.recordings import reader
from drivers.recordings.mcap import McapWriter
from drivers.recordings.reader import RecordingReader
from drivers.timing.delay import Delay
from slam import Slam
from slam.cli.run_input import RecordingInput
from slam.config import Config, load_config
from slam.io.recording_timing import RecordingTiming
from slam.io.recordings import reason_without_odometry

from ...drivers.timing.drives import office_drive, with_late_scans, with_turned_lidar

DELAY = 0.3


@pytest.fixture(scope="module")
def wrong_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording whose beams' times are reversed and whose scans are late."""
    path = tmp_path_factory.mktemp("timing") / "drive.mcap"
    with McapWriter(path) as writer:
        for message in with_late_scans(office_drive(), DELAY):
            writer.write(with_reversed_times(message) if isinstance(message, Scan) else message)
    return path


def test_both_errors_are_found_and_corrected(wrong_recording: Path) -> None:
    source = drivers.open(wrong_recording)
    run_input = RecordingInput(source, reopen=str(wrong_recording))
    config = run_input.resolve(Config())
    assert config.lidar.delay == pytest.approx(DELAY, abs=0.03)
    timing = run_input.facts()["timing"]
    assert timing["beams_reversed"]
    assert timing["compensated_delay"] == config.lidar.delay
    found = RecordingTiming.of(source, Config().lidar)
    order, delay = found.corrections()
    assert order.startswith("beams in the opposite of the stated order, by ")
    assert delay.endswith("late against odometry; compensated")
    assert found.findings() == []
    assert run_input.facts()["interpretations"] == [order, delay]


def input_with_turned_lidar(path: Path, stated: bool) -> RecordingInput:
    """Return a recording with a lidar that points backwards; its mount is not stated, or wrongly as ahead."""
    with McapWriter(path) as writer:
        for message in with_turned_lidar(office_drive(), np.pi):
            writer.write(replace(message, mount=np.zeros(3)) if stated and isinstance(message, Scan) else message)
    return RecordingInput(drivers.open(path), reopen=str(path))


def test_a_lidar_that_points_backwards_is_corrected_if_no_mount_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    run_input = input_with_turned_lidar(path, stated=False)
    config = run_input.resolve(Config())
    assert config.lidar.mount is not None
    assert config.lidar.mount[:2] == (0.0, 0.0)
    assert abs(config.lidar.mount[2]) == pytest.approx(np.pi, abs=0.05)
    text = run_input.facts()["interpretations"][-1]
    assert re.match(r"lidar turned by -?1(79|80) ± \d degrees on the robot", text)
    assert run_input.facts()["doubts"] == []
    for heading, doubts in ((3.1, 0), (0.0, 1)):
        settings = load_config(None, [f"lidar.mount=[0,0,{heading}]"])
        timing = RecordingTiming.of(drivers.open(path), settings.lidar)
        assert len(timing.doubts()) == doubts
        assert timing.compensated(settings) == settings


def test_a_lidar_that_contradicts_its_stated_mount_is_doubtful(tmp_path: Path) -> None:
    run_input = input_with_turned_lidar(tmp_path / "drive.mcap", stated=True)
    assert run_input.resolve(Config()).lidar.mount is None
    (doubt,) = run_input.facts()["doubts"]
    assert re.match(r"the lidar seems to be turned by -?1(79|80) ± \d degrees on the robot", doubt)


def test_settings_take_precedence(wrong_recording: Path) -> None:
    config = load_config(None, ["lidar.beam_order=forward", "lidar.delay=0"])
    source = drivers.open(wrong_recording, config.lidar.beam_order)
    timing = RecordingTiming.of(source, config.lidar)
    assert timing.beam_times.as_stated
    assert timing.used_delay == 0.0
    assert timing.compensated(config) == config


def test_simulation_is_taken_as_it_is() -> None:
    assert RecordingInput(drivers.open("sim:room"), reopen="sim:room").resolve(Config()) == Config()


def test_delay_of_the_settings_moves_odometry() -> None:
    drive = office_drive()[:400]
    compensating, shifted = Slam(load_config(None, [f"lidar.delay={DELAY}"])), Slam()
    for message in drive:
        compensating.add(message)
        shifted.add(delay_odometry(message, DELAY))
    one, other = compensating.finish(), shifted.finish()
    np.testing.assert_array_equal(one.stamps, other.stamps)
    np.testing.assert_array_equal(one.poses, other.poses)


@pytest.mark.parametrize(
    ("second", "used"),
    [
        (None, 0.3),
        (Delay(0.31, 0.02, None), 0.3),
        (Delay(0.28, 0.02, "shorter than the period of the scans"), 0.3),
        (Delay(0.8, 0.02, None), 0.8),
        (Delay(0.01, 0.02, "not significant"), 0.0),
    ],
)
def test_lidars_have_one_delay_unless_they_clearly_differ(second: Delay | None, used: float) -> None:
    first = RecordingTiming(delay=Delay(0.32, 0.02, None), used_delay=0.3)
    own = 0.0 if second is None or second.objection else second.seconds
    assert RecordingTiming(delay=second, used_delay=own).beside(first).used_delay == used


@pytest.mark.parametrize(("kept", "readings"), [(reader.MAX_KEPT_BYTES, 1), (0, 2)])
def test_a_run_reads_a_recording_once_if_it_is_small(
    monkeypatch: pytest.MonkeyPatch, wrong_recording: Path, kept: int, readings: int
) -> None:
    """What has to be known before is found in the messages that are mapped; those of large ones are not kept."""
    monkeypatch.setattr(reader, "MAX_KEPT_BYTES", kept)
    ends: list[RecordingReader] = []
    read = RecordingReader._messages

    def counted(self: RecordingReader) -> Iterator[Message]:
        yield from read(self)
        ends.append(self)

    monkeypatch.setattr(RecordingReader, "_messages", counted)
    source = drivers.open(wrong_recording)
    assert reason_without_odometry(source) is None
    run_input = RecordingInput(source, reopen=str(wrong_recording))
    run_input.resolve(Config())
    assert len(ends) == 1
    with run_input.opened(lambda: None) as messages:
        assert sum(1 for _ in messages) == len(source)
    assert ends == readings * [source]
