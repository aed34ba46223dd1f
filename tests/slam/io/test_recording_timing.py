"""Timing errors of a recording are corrected in a run, shown by `wclm info`, and can be set."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from typer.testing import CliRunner

import drivers
from drivers.devices.device_spec import parse_devices
from drivers.messages import Message, Scan, Source, delay_odometry, with_reversed_times
from drivers.recordings import surveyed_recording
from drivers.recordings.mcap import McapWriter
from drivers.recordings.reader import RecordingReader
from drivers.simulation import LIDAR_MODELS, Simulation
from drivers.timing.beam_times import STATED, BeamTimes
from drivers.timing.delay import Delay
from drivers.timing.mount_heading import MountHeading
from slam import Slam
from slam.cli import acquisition_loop
from slam.cli.app import app
from slam.cli.commands.live_input import LiveInput
from slam.cli.message_pump import MessagePump
from slam.cli.run_controls import RunControls
from slam.cli.run_input import RecordingInput
from slam.config import Config, LidarConfig, SecondLidarConfig, load_config
from slam.io.recording_timing import UNKNOWN_MOUNT, RecordingTiming, timed
from slam.io.recordings import open_source, reason_without_odometry
from slam.io.stored_session import StoredSession

from ...drivers.timing.drives import mirrored, office_drive, with_late_scans, with_turned_lidar

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
            mounted = stated and isinstance(message, Scan)
            writer.write(replace(message, mount=np.array([0.1, 0.0, 0.0])) if mounted else message)
    return RecordingInput(drivers.open(path), reopen=str(path))


@pytest.mark.parametrize(("odometry", "doubts"), [(True, [UNKNOWN_MOUNT]), (False, [])])
def test_a_mount_that_nothing_states_is_doubtful_beside_odometry(
    tmp_path: Path, odometry: bool, doubts: list[str]
) -> None:
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        for message in Simulation("room", duration=3.0, mount=(0.2, 0.0, 0.0)):
            if isinstance(message, Scan):
                writer.write(replace(message, mount=None))
            elif odometry:
                writer.write(message)
    assert RecordingTiming.of(drivers.open(path)).doubts() == doubts
    assert RecordingTiming.of(drivers.open(path), LidarConfig(mount=(0.2, 0.0, 0.0))).doubts() == []


@pytest.mark.slow
def test_a_lidar_that_points_backwards_is_corrected_if_no_mount_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    run_input = input_with_turned_lidar(path, stated=False)
    config = run_input.resolve(Config())
    assert config.lidar.mount is not None
    assert config.lidar.mount[:2] == (0.0, 0.0)
    assert abs(config.lidar.mount[2]) == pytest.approx(np.pi, abs=0.05)
    text = run_input.facts()["interpretations"][-1]
    assert re.match(r"lidar turned by -?1(79|80)\.\d ± \d\.\d degrees on the robot", text)
    assert run_input.facts()["doubts"] == [UNKNOWN_MOUNT]
    for heading, doubts in ((3.1, 0), (0.0, 1)):
        settings = load_config(None, [f"lidar.mount=[0,0,{heading}]"])
        timing = RecordingTiming.of(drivers.open(path), settings.lidar)
        assert len(timing.doubts()) == doubts
        assert timing.compensated(settings) == settings


def test_a_lidar_that_contradicts_its_stated_mount_is_doubtful(tmp_path: Path) -> None:
    run_input = input_with_turned_lidar(tmp_path / "drive.mcap", stated=True)
    assert run_input.resolve(Config()).lidar.mount is None
    (doubt,) = run_input.facts()["doubts"]
    turn, mount = r"-?1(79|80)\.\d ± \d\.\d degrees on the robot", r"lidar\.mount=\[0\.1,0,-?3\.1\d\]"
    assert re.match(rf"the lidar seems to be turned by {turn}, but by 0 by its mount: set {mount}, or", doubt)


def test_settings_take_precedence(wrong_recording: Path) -> None:
    config = load_config(None, ["lidar.beam_order=forward", "lidar.delay=0"])
    source = drivers.open(wrong_recording, config.lidar.beam_order)
    timing = RecordingTiming.of(source, config.lidar)
    assert timing.beam_times.as_stated
    assert timing.used_delay == 0.0
    assert timing.compensated(config) == config


@pytest.fixture(scope="module")
def recording_without_times(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording of a lidar that turns, whose scans state no times of the beams, nor a mount: it points backwards."""
    path = tmp_path_factory.mktemp("timing") / "drive.mcap"
    with McapWriter(path) as writer:
        for message in with_turned_lidar(mirrored(office_drive()), np.pi):
            timeless = isinstance(message, Scan)
            writer.write(replace(message, time_offsets=np.zeros(len(message.ranges))) if timeless else message)
    return path


@pytest.mark.slow
def test_info_states_the_settings_that_correct_the_same_live(recording_without_times: Path) -> None:
    found = CliRunner().invoke(app, ["info", str(recording_without_times)])
    assert found.exit_code == 0, found.output
    (line,) = [line for line in found.output.splitlines() if line.startswith("  live, ros ")]
    options = shlex.split(line.removeprefix("  live, ros "))
    assert options[::2] == ["--set"] * 3
    config = load_config(None, options[1::2])
    assert config.lidar.beam_order == "reversed"
    assert config.lidar.turn_period == pytest.approx(1.0 / LIDAR_MODELS["short"].rate, rel=0.01)
    assert config.lidar.mount is not None
    corrected = RecordingInput(drivers.open(recording_without_times), "").resolve(Config())
    assert config.lidar.mount == pytest.approx(corrected.lidar.mount, abs=1e-4)

    set_times = open_source(recording_without_times, config)
    (described,) = RecordingTiming.of(set_times, config.lidar).corrections()
    assert described == f"beams measured over clockwise turns of {config.lidar.turn_period:.3f} s, as set"
    for scan, as_found in zip(scans_of(set_times), scans_of(drivers.open(recording_without_times)), strict=True):
        np.testing.assert_allclose(scan.time_offsets, as_found.time_offsets, atol=1e-4)


def test_nothing_is_said_of_the_beams_of_a_robot_that_stands(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    scans = scans_of(drivers.open("sim:room?duration=5"))
    with McapWriter(path) as writer:
        for k in range(50):
            writer.write(replace(scans[0], stamp=scans[0].stamp + 0.1 * k))
    assert RecordingTiming.of(drivers.open(path)).findings() == []


def test_nothing_is_to_be_set_if_nothing_is_corrected() -> None:
    assert RecordingTiming.of(drivers.open("sim:room")).settings() == []
    assert "live, ros" not in CliRunner().invoke(app, ["info", "sim:room?duration=2"]).output


def scans_of(source: Source) -> list[Scan]:
    return [message for message in source if isinstance(message, Scan)]


def test_beams_of_devices_have_the_times_that_are_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """Devices of this project state right times, but not each firmware is known."""
    drive = list(drivers.open("sim:room?duration=2"))
    monkeypatch.setattr(acquisition_loop, "receive_messages", lambda pump, duration, after_each: iter(drive))
    live = LiveInput(parse_devices("rplidar:/dev/ttyUSB0"), None, None, None, RunControls())
    for settings, times in (
        ([], STATED),
        (["lidar.turn_period=0.2", "lidar.beam_order=reversed"], BeamTimes(0.2, True)),
    ):
        config = load_config(None, settings)
        assert live.resolve(config) == config
        received = list(live._messages(MessagePump(live._acquisition, lambda message: None), lambda: None))
        assert len(received) == len(drive)
        for message, sent in zip(received, drive, strict=True):
            if isinstance(message, Scan) and isinstance(sent, Scan):
                assert np.array_equal(message.time_offsets, times.of(sent).time_offsets)
            else:
                assert message is sent


@pytest.mark.parametrize(("spec", "used"), [("", (0.1, 0.0, 3.0)), ("?mount=0.2,0,0", None)])
def test_a_device_is_mounted_as_in_the_session_if_nothing_else_states_it(
    capsys: pytest.CaptureFixture[str], spec: str, used: tuple[float, float, float] | None
) -> None:
    """A recording that shows that its lidar points backwards may be continued live."""
    session = cast(StoredSession, SimpleNamespace(last_mount=(0.1, 0.0, 3.0)))
    devices = parse_devices(f"rplidar:/dev/ttyUSB0{spec}")
    live = LiveInput(devices, None, None, None, RunControls(), earlier=session)
    assert live.resolve(Config()).lidar.mount == used
    stated = Config(lidar=LidarConfig(mount=(0.0, 0.0, 1.0)))
    assert live.resolve(stated) == stated
    assert ("heading 171.9 degrees, as in the session" in capsys.readouterr().err) == (used is not None)


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


def test_the_mount_of_the_session_is_used_if_nothing_else_states_it(tmp_path: Path) -> None:
    """A short drive may not show again that the lidar points backwards."""
    path, session = tmp_path / "drive.mcap", SimpleNamespace(last_mount=(0.1, 0.0, 3.0))
    with McapWriter(path) as writer:
        for message in Simulation("room", duration=2.0):
            writer.write(replace(message, mount=None) if isinstance(message, Scan) else message)
    run_input = RecordingInput(drivers.open(path), str(path), cast(StoredSession, session))
    assert run_input.resolve(Config()).lidar.mount == (0.1, 0.0, 3.0)
    facts = run_input.facts()
    used = "lidar mounted at x 0.100 m, y 0.000 m, heading 171.9 degrees, as in the session, as no mount is stated"
    assert facts["interpretations"] == [used]
    assert facts["doubts"] == []
    stated = Config(lidar=LidarConfig(mount=(0.0, 0.0, 1.0)))
    assert run_input.resolve(stated).lidar.mount == (0.0, 0.0, 1.0)
    other = RecordingInput(Simulation("room", duration=1.0), "sim:room", cast(StoredSession, session))
    assert other.resolve(Config()).lidar.mount is None


def test_the_mount_that_is_found_of_a_second_lidar_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    turned = RecordingTiming(mount_heading=MountHeading(None, 3.0, 0.01, 20))
    monkeypatch.setattr(RecordingTiming, "of", lambda *_: RecordingTiming())
    monkeypatch.setattr(RecordingTiming, "of_second", lambda *_: turned)
    config, *_ = timed(Simulation("room"), Config())
    assert config.lidar.mount is None
    assert config.second_lidar.mount == (0.0, 0.0, 3.0)
    stated = Config(second_lidar=SecondLidarConfig(topic="/rear", mount=(0.1, 0.0, 1.0)), lidar=LidarConfig(topic="/a"))
    config, *_ = timed(Simulation("room"), stated)
    assert (config.lidar.mount, config.second_lidar.mount) == (None, (0.1, 0.0, 1.0))


@pytest.mark.parametrize(("kept", "readings"), [(surveyed_recording.MAX_KEPT_BYTES, 1), (0, 2)])
def test_a_run_reads_a_recording_once_if_it_is_small(
    monkeypatch: pytest.MonkeyPatch, wrong_recording: Path, kept: int, readings: int
) -> None:
    """What has to be known before is found in the messages that are mapped; those of large ones are not kept."""
    monkeypatch.setattr(surveyed_recording, "MAX_KEPT_BYTES", kept)
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
