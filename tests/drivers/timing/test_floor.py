"""The floor is recognised in scans of a lidar that is not level, and nothing else is taken for it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import drivers
from drivers import se2
from drivers.messages import Floats, Odometry, Scan, SourceReport
from drivers.recordings.mcap import McapWriter
from drivers.timing.floor import Floor, FloorDetector
from drivers.timing.watched_view import watched
from slam.cli.app import app
from slam.cli.run_input import RecordingInput
from slam.config import Config
from slam.io.recording_timing import RecordingTiming

from .room_views import ANGLES, RANGE_MAX, World, drive, room, round_room, seeing_line, spinning


def found(world: World, path: Floats, range_max: float = RANGE_MAX) -> Floor | None:
    """Return the floor that is found on a path through a world."""
    detector = FloorDetector()
    for message in drive(world, path, range_max):
        detector.add(message)
    return detector.found()


@pytest.mark.parametrize(("distance", "bearing"), [(4.6, 0.0), (4.6, 1.6), (2.0, -3.0), (8.0, 0.5)])
def test_the_floor_is_found_in_a_hall(distance: float, bearing: float) -> None:
    floor = found(seeing_line(room(30.0, 20.0), distance, bearing), spinning())
    assert floor is not None
    assert floor.distance == pytest.approx(distance, rel=0.05)
    assert abs(se2.wrap(floor.bearing - bearing)) < np.radians(4.0)
    assert 0.9 * distance < floor.safe_range < distance


def test_the_floor_is_found_by_a_robot_that_nods() -> None:
    floor = found(seeing_line(room(30.0, 20.0), 4.6, 0.0, nodding=0.06), spinning())
    assert floor is not None
    assert floor.distance == pytest.approx(4.6, rel=0.1)
    assert floor.safe_range < 4.6


@pytest.mark.parametrize("range_max", [RANGE_MAX, 4.0])
@pytest.mark.parametrize("world", [room(30.0, 20.0), room(5.0, 5.0), room(40.0, 2.0), round_room(3.0)])
def test_walls_are_no_floor(world: World, range_max: float) -> None:
    assert found(world, spinning(), range_max) is None


def test_the_wall_of_a_round_room_that_is_followed_is_no_floor() -> None:
    headings = np.arange(0.0, 4.0 * np.pi, np.radians(2.0))
    around = np.column_stack([3.0 * np.sin(headings), -3.0 * np.cos(headings), headings])
    assert found(round_room(4.5), around) is None


@pytest.mark.parametrize("turn", [1.0, -4.0, 60.0])
def test_the_wall_of_a_corridor_is_no_floor_though_odometry_turns(turn: float) -> None:
    """As with a broken encoder: radians per metre."""
    way = np.arange(-15.0, 15.0, 0.08)
    detector = FloorDetector()
    for message in drive(room(40.0, 2.0), np.column_stack([way, np.zeros((len(way), 2))])):
        if isinstance(message, Odometry):
            turned = turn * (message.pose[0] + 15.0)
            message = replace(message, pose=message.pose + np.array([0.0, 0.0, turned]))
        detector.add(message)
    assert detector.found() is None


def test_no_returns_that_are_stated_as_a_range_are_no_floor() -> None:
    hall = room(30.0, 20.0)
    assert found(lambda pose: np.minimum(hall(pose), 5.0), spinning()) is None


def test_a_part_of_the_robot_is_no_floor() -> None:
    assert found(seeing_line(room(30.0, 20.0), 1.3, 0.0, width=0.5), spinning()) is None


def test_the_floor_is_not_found_without_turns() -> None:
    straight = np.column_stack([np.arange(-8.0, 8.0, 0.1), np.zeros((160, 2))])
    assert found(seeing_line(room(30.0, 20.0), 4.6, 0.0), straight) is None
    assert FloorDetector().found() is None


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording of a robot whose lidar sees the floor to its left."""
    path = tmp_path_factory.mktemp("floor") / "drive.mcap"
    with McapWriter(path) as writer:
        for message in drive(seeing_line(room(30.0, 20.0), 4.6, np.pi / 2), spinning()):
            writer.write(message)
    return path


def test_returns_on_the_floor_are_left_out_and_others_are_not(recording: Path) -> None:
    source = drivers.open(recording)
    level = [message for message in drive(room(30.0, 20.0), spinning()) if isinstance(message, Scan)]
    read = [message for message in source if isinstance(message, Scan)]
    left = np.sin(ANGLES) * np.array([scan.ranges for scan in read])
    assert np.nanmax(left) < 4.4
    of_others = np.abs(se2.wrap(ANGLES - np.pi / 2)) > np.pi / 2
    for scan, true in zip(read, level, strict=True):
        np.testing.assert_array_equal(scan.ranges[of_others], true.ranges[of_others])


@pytest.mark.slow
def test_info_and_a_run_state_the_floor_and_its_cure(recording: Path) -> None:
    config = Config()
    run_input = RecordingInput(drivers.open(recording), reopen=str(recording))
    assert run_input.resolve(config) == config
    with run_input.opened(lambda: None) as messages:
        assert sum(1 for _ in messages) > 200
    (found,) = run_input.facts()["interpretations"]
    line = r"it sees the floor in a line 4\.[5-7] m away at a bearing of (89|9\d) degrees"
    assert re.match(rf"the lidar is not level: {line}, which turned with the robot in \d+ scans", found)
    assert found.endswith("these returns are left out, but it should be mounted level")
    output = CliRunner().invoke(app, ["info", str(recording)]).output
    assert f"  read as     {found}" in output.splitlines()
    assert re.search(r"--set lidar\.range_max=4\.[1-4]$", output, re.MULTILINE)


@pytest.mark.parametrize(("range_max", "doubts"), [(60.0, 1), (4.2, 0)])
def test_the_floor_is_a_doubt_live_unless_it_is_out_of_range(range_max: float, doubts: int) -> None:
    messages, report = list(drive(seeing_line(room(30.0, 20.0), 4.6, 0.0), spinning())), SourceReport()
    for passed_on, message in zip(watched(messages, report, (0.0, range_max)), messages, strict=True):
        assert passed_on is message
    assert len(report.doubts) == doubts
    assert all(re.search(r"mount it level, or set lidar\.range_max=4\.[1-4]$", doubt) for doubt in report.doubts)


def test_a_level_lidar_is_read_as_it_is(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in drive(room(30.0, 20.0), spinning()):
            writer.write(message)
    source = drivers.open(tmp_path / "drive.mcap")
    for read, true in zip(source, drive(room(30.0, 20.0), spinning()), strict=True):
        if isinstance(read, Scan) and isinstance(true, Scan):
            np.testing.assert_array_equal(read.ranges, true.ranges)
    assert source.report.interpretations == []
    assert RecordingTiming.of(source).settings() == []
