"""Parts of the robot in view of its lidar are recognised and left out, and nothing else is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import drivers
from drivers import se2
from drivers.messages import Floats, Message, Odometry, Scan, SourceReport
from drivers.recordings.mcap import McapWriter
from drivers.timing.own_returns import OwnReturns, OwnReturnsDetector
from drivers.timing.watched_view import watched
from slam.cli.app import app
from slam.io.recording_timing import RecordingTiming

from .room_views import ANGLES, World, drive, room, round_room, seeing_line, spinning

HALL, POST_WIDTH = room(30.0, 20.0), np.radians(9.0)


def seeing_posts(world: World, distance: float = 0.2, bearings: Iterable[float] = (0.8, -2.0)) -> World:
    """Return a world in which the lidar is between posts of the robot."""
    for bearing in bearings:
        world = seeing_line(world, distance, bearing, POST_WIDTH)
    return world


def found(messages: Iterable[Message]) -> OwnReturns | None:
    """Return what a drive shows of the robot."""
    detector = OwnReturnsDetector()
    for message in messages:
        detector.add(message)
    return detector.found()


def scans_of(messages: Iterable[Message]) -> list[Message]:
    return [message for message in messages if isinstance(message, Scan)]


def turning_odometry(messages: Iterable[Message], turn: float) -> Iterable[Message]:
    """Yield messages with odometry that turns by mistake, radians per metre along x."""
    for message in messages:
        if isinstance(message, Odometry):
            turned = np.array([0.0, 0.0, turn * message.pose[0]])
            message = replace(message, pose=message.pose + turned)
        yield message


def along_corridor() -> Floats:
    """Return the path (n, 3) of a robot that drives straight on."""
    way = np.arange(-15.0, 15.0, 0.08)
    return np.column_stack([way, np.zeros((len(way), 2))])


@pytest.mark.parametrize("bearing", [0.0, 1.6, -3.1])
@pytest.mark.parametrize("distance", [0.15, 0.8])
def test_a_part_of_the_robot_is_found(distance: float, bearing: float) -> None:
    own = found(drive(seeing_line(HALL, distance, bearing, 0.5), spinning()))
    assert own is not None
    ((first, last),) = own.sectors
    assert abs(se2.wrap(first - bearing) + 0.5) < np.radians(4.0)
    assert abs(se2.wrap(last - bearing) - 0.5) < np.radians(4.0)
    assert distance / np.cos(0.5) < own.farthest < 1.1 * distance / np.cos(0.5) + 0.05
    assert own.farthest <= own.safe_range < own.farthest + 0.1


@pytest.mark.parametrize(
    "messages",
    [
        pytest.param(drive(HALL, spinning()), id="hall"),
        pytest.param(drive(room(1.0, 1.0), spinning(4.0)), id="closet"),
        pytest.param(drive(room(40.0, 1.2), along_corridor()), id="corridor"),
        pytest.param(turning_odometry(drive(room(40.0, 1.2), along_corridor()), 1.0), id="wrong turns"),
        pytest.param(drive(round_room(0.8), np.array([[0.0, 0.0, h] for h in np.arange(0.0, 40.0, 0.1)])), id="round"),
        pytest.param([], id="nothing"),
    ],
)
def test_what_stands_in_the_building_is_no_part_of_the_robot(messages: Iterable[Message]) -> None:
    assert found(messages) is None


@pytest.mark.parametrize("distance", [0.15, 0.8])
def test_without_odometry_the_scans_show_the_turns(distance: float) -> None:
    world = seeing_posts(room(9.0, 7.0), distance)
    driving = spinning() + np.column_stack([np.linspace(0.0, 2.0, len(spinning())), *np.zeros((2, len(spinning())))])
    for path in (spinning(), driving):
        own = found(scans_of(drive(world, path)))
        assert own is not None
        assert [np.degrees(first) for first, _ in own.sectors] == pytest.approx([-125.0, 36.0], abs=4.0)


@pytest.mark.parametrize(
    "messages",
    [
        pytest.param(drive(HALL, spinning()), id="hall"),
        pytest.param(drive(room(1.0, 1.0), spinning(4.0)), id="closet"),
        pytest.param(drive(room(40.0, 1.2), along_corridor()), id="corridor"),
        pytest.param(drive(seeing_posts(room(40.0, 2.0)), along_corridor()), id="posts in a corridor"),
        pytest.param(drive(seeing_posts(HALL), np.zeros((100, 3))), id="standing"),
    ],
)
def test_without_odometry_and_turns_nothing_is_found(messages: Iterable[Message]) -> None:
    assert found(scans_of(messages)) is None


def test_sectors_are_named_in_their_order() -> None:
    own = found(drive(seeing_posts(HALL, 0.2, (0.0, 2.0, -1.0)), spinning()))
    assert own is not None
    middles = [se2.wrap(first + 0.5 * float(se2.wrap(last - first))) for first, last in own.sectors]
    np.testing.assert_allclose(middles, [-1.0, 0.0, 2.0], atol=np.radians(2.0))


def test_what_the_robot_sees_now_and_then_is_no_part_of_it() -> None:
    """A person who follows it, for two of three turns."""
    followed, alone = drive(seeing_posts(HALL), spinning(9.0)), drive(HALL, spinning(9.0))
    third = len(spinning(9.0)) * 2 // 3  # two messages for each pose
    both = [pair[number // third % 3 == 2] for number, pair in enumerate(zip(followed, alone, strict=True))]
    assert found(both) is None


def test_a_part_of_the_robot_is_not_found_without_turns() -> None:
    assert found(drive(seeing_posts(room(40.0, 2.0)), along_corridor())) is None


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recording of a robot with two posts."""
    path = tmp_path_factory.mktemp("posts") / "drive.mcap"
    with McapWriter(path) as writer:
        for message in drive(seeing_posts(HALL), spinning()):
            writer.write(message)
    return path


def test_returns_from_the_robot_are_left_out_and_others_are_not(recording: Path) -> None:
    scans = [message for message in drivers.open(recording) if isinstance(message, Scan)]
    true = [message for message in drive(HALL, spinning()) if isinstance(message, Scan)]
    of_robot = np.any([np.abs(se2.wrap(ANGLES - bearing)) < POST_WIDTH for bearing in (0.8, -2.0)], axis=0)
    for scan, without in zip(scans, true, strict=True):
        assert np.isnan(scan.ranges[of_robot]).all()
        np.testing.assert_array_equal(scan.ranges[~of_robot], without.ranges[~of_robot])


@pytest.mark.slow
def test_info_states_the_robot_in_view_and_the_setting_for_live_runs(recording: Path) -> None:
    source = drivers.open(recording)
    assert sum(1 for _ in source) > 200
    (line,) = source.report.interpretations
    where = r"up to 0\.2\d m away at bearings of -122 to -106, 38 to 54 degrees"
    assert re.match(rf"the lidar sees the robot itself, {where}: the returns there were the same in \d\d scans", line)
    assert line.endswith("they are left out")
    output = CliRunner().invoke(app, ["info", str(recording)]).output
    assert f"  read as     {line}" in output.splitlines()
    assert "--set lidar.range_min=0.3" in output
    timing = RecordingTiming.of(drivers.open(recording))
    assert timing.settings() == ["lidar.range_min=0.3"]
    assert timing.doubts() == []


@pytest.mark.parametrize(("range_min", "doubts"), [(0.05, 1), (0.3, 0)])
def test_the_robot_in_view_is_a_doubt_live_unless_it_is_out_of_range(range_min: float, doubts: int) -> None:
    messages, report = list(drive(seeing_posts(HALL), spinning())), SourceReport()
    for passed_on, message in zip(watched(messages, report, (range_min, 60.0)), messages, strict=True):
        assert passed_on is message
    assert len(report.doubts) == doubts
    assert all(doubt.endswith("; set lidar.range_min=0.3") for doubt in report.doubts)
