"""A lidar that is upside down is found by the turns of odometry, and its scans are mirrored if no mount is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan, YawRate, mirrored
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation, load_world
from drivers.timing.turn_scale import TurnScale, estimate_turn_scale
from drivers.timing.turns import Run, Turns
from drivers.timing.upside_down import OdometryTurns, compare_odometry_turns
from slam.io.recording_timing import UNKNOWN_MOUNT, RecordingTiming
from slam.io.recordings import reason_without_odometry

from .drives import office_drive


def upside_down(*, stated: bool) -> list[Message]:
    """Return a drive whose scans are mirrored, with or without the lidar's mount."""
    return [
        replace(mirrored(message), mount=message.mount if stated else None) if isinstance(message, Scan) else message
        for message in office_drive()
    ]


def written(path: Path, messages: Sequence[Message]) -> str:
    with McapWriter(path) as writer:
        for message in messages:
            writer.write(message)
    return str(path)


def test_a_scan_that_is_mirrored_twice_is_as_before() -> None:
    scan = next(message for message in office_drive() if isinstance(message, Scan))
    again = mirrored(mirrored(scan))
    assert np.all(np.diff(mirrored(scan).angles) > 0.0)
    for name in ("ranges", "angles", "time_offsets"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scan, name))


def test_scans_without_a_mount_are_mirrored(tmp_path: Path) -> None:
    source = drivers.open(written(tmp_path / "drive.mcap", upside_down(stated=False)))
    read = [message for message in source if isinstance(message, Scan)]
    true = [message for message in office_drive() if isinstance(message, Scan)]
    np.testing.assert_array_equal([scan.ranges for scan in read], [scan.ranges for scan in true])
    assert any("upside down" in line for line in source.report.interpretations)
    timing = RecordingTiming.of(source)
    assert timing.doubts() == [UNKNOWN_MOUNT]
    assert timing.beam_times.as_stated


def test_odometry_is_not_doubted_by_a_depth_camera() -> None:
    """It sees 58 degrees up to 4 m, so scans have little in common after a turn, and often few returns at all."""
    camera = LidarModel(beams=2000, field_of_view=np.radians(58.0), range_min=0.3, range_max=4.0, sigma_range=0.02)
    around_core = np.array([[5.2, 5.0], [10.0, 4.9], [19.8, 5.0], [19.8, 10.0], [10.0, 10.0], [5.2, 9.9], [5.2, 5.0]])
    drive = Simulation(replace(load_world("office"), waypoints=around_core), seed=1, lidar=camera)
    compared = compare_odometry_turns(Turns(drive))
    assert compared is not None
    assert compared.reason_to_ignore() is None
    assert compared.reason_to_mirror() is None


def test_a_stated_mount_is_doubted_and_nothing_is_mirrored(tmp_path: Path) -> None:
    messages = upside_down(stated=True)
    source = drivers.open(written(tmp_path / "drive.mcap", messages))
    read = [message for message in source if isinstance(message, Scan)]
    np.testing.assert_array_equal(read[9].ranges, [m for m in messages if isinstance(m, Scan)][9].ranges)
    assert "the lidar is upside down, which its mount does not state" in "".join(RecordingTiming.of(source).doubts())


def test_an_upright_lidar_is_read_as_it_is(tmp_path: Path) -> None:
    messages = [replace(m, mount=None) if isinstance(m, Scan) else m for m in office_drive()]
    source = drivers.open(written(tmp_path / "drive.mcap", messages))
    read = [message for message in source if isinstance(message, Scan)]
    np.testing.assert_array_equal(read[9].ranges, [m for m in messages if isinstance(m, Scan)][9].ranges)
    assert source.report.interpretations == []


def test_odometry_that_hardly_turns_is_doubted() -> None:
    straight = [
        replace(message, pose=message.pose * np.array([1.0, 1.0, 0.01])) if isinstance(message, Odometry) else message
        for message in office_drive()
    ]
    found = compare_odometry_turns(Turns(straight))
    assert found is not None
    assert found.reason_to_mirror() is None
    assert "does not measure the turns" in "".join(found.doubts(corrected=False))


@pytest.mark.parametrize("gyroscope", [False, True])
def test_odometry_with_turns_in_another_unit_is_ignored_unless_a_gyroscope_replaces_them(
    tmp_path: Path, gyroscope: bool
) -> None:
    messages, before = list[Message](), np.zeros(3)
    for message in office_drive():
        if isinstance(message, Odometry):
            if gyroscope:
                messages.append(YawRate(message.stamp, 25.0 * float(se2.wrap(message.pose - before)[2])))
            before = message.pose
            message = replace(message, pose=message.pose * [1.0, 1.0, np.degrees(1.0)])
        messages.append(message)
    source = drivers.open(written(tmp_path / "drive.mcap", messages))
    reason = reason_without_odometry(source)
    assert reason is None if gyroscope else reason is not None and "does not measure the turns" in reason


@pytest.mark.parametrize(("found", "sigma"), [(-1.0, 0.3), (0.0, 0.2), (0.6, 0.001), (1.9, 0.001)])
def test_what_is_uncertain_is_not_doubted(found: float, sigma: float) -> None:
    turns = OdometryTurns(TurnScale(found, sigma, 20))
    assert turns.reason_to_mirror() is None
    assert turns.doubts(corrected=False) == []


def test_odometry_is_not_doubted_if_a_single_turn_decides_which_matches_are_wrong() -> None:
    headings, matched = np.zeros(21), np.random.default_rng(0).normal(0.0, 1e-3, 21)
    headings[5:] -= 0.15
    for at, turn in ((5, -0.15), (10, 0.13), (15, -0.08)):  # the latter two are wrong
        matched[at:] += turn
    stamps = np.arange(21.0)
    found = estimate_turn_scale([Run([], stamps, np.column_stack([np.zeros((21, 2)), matched]))], stamps, headings, 2.0)
    assert found is not None
    assert found.found == pytest.approx(0.0, abs=0.01)
    assert OdometryTurns(found).reason_to_ignore() is None


def test_a_robot_that_does_not_turn_shows_nothing() -> None:
    """The noise of scan matching is no turn that odometry should have measured."""
    drive = list(drivers.open("sim:corridor?duration=15&lidar=short"))
    straight = [message for message in drive if not isinstance(message, GroundTruth)]
    ahead = [replace(m, pose=m.pose * np.array([1.0, 1.0, 0.0])) if isinstance(m, Odometry) else m for m in straight]
    turns = Turns(shaken(ahead))
    assert turns.runs
    assert compare_odometry_turns(turns) is None


def shaken(messages: list[Message]) -> list[Message]:
    """Return the messages with readings of odometry that turn by a ten-thousandth of a radian, so as not to stand."""
    return [
        replace(m, pose=m.pose + np.array([0.0, 0.0, 1e-4 * (k % 2)])) if isinstance(m, Odometry) else m
        for k, m in enumerate(messages)
    ]


def test_nothing_is_found_without_odometry() -> None:
    assert compare_odometry_turns(Turns([])) is None
    assert compare_odometry_turns(Turns([message for message in office_drive() if isinstance(message, Scan)])) is None
