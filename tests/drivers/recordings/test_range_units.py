"""Ranges in millimetres and centimetres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, Scan, SourceReport, se2
from drivers.recordings.carmen import CarmenReader
from drivers.recordings.mcap import McapReader, McapWriter
from drivers.recordings.range_units import ScanInUnits, find_range_unit
from drivers.recordings.ros_encoder import RosEncoder
from drivers.simulation import LidarModel, Simulation

from ...recordings import dataset_file, recording_file
from ..conftest import ros_entries, write_bag1

UNITS = {1000.0: "millimetres", 100.0: "centimetres"}


class Report:
    """Recorder of what a reader reports."""

    def __init__(self) -> None:
        self.report = SourceReport()

    def interpret(self, text: str) -> None:
        self.report.interpretations.append(text)

    def doubt(self, text: str) -> None:
        self.report.doubts.append(text)


def scans_in_units(messages: list[Message], per_metre: float) -> list[ScanInUnits]:
    """Return the scans with whole numbers as ranges, zero for no-returns."""
    scans, pose = [], np.zeros(3)
    for message in messages:
        if isinstance(message, Odometry):
            pose = message.pose
        elif isinstance(message, Scan):
            mount = np.zeros(3) if message.mount is None else message.mount
            readings = np.round(np.nan_to_num(message.ranges) * per_metre)
            scans.append(ScanInUnits(message.angles, readings, se2.compose(pose, mount)))
    return scans


def find(scans: list[ScanInUnits]) -> tuple[float, SourceReport]:
    report = Report()
    return find_range_unit([scan.readings for scan in scans], scans, report), report.report


@pytest.fixture(scope="module")
def office() -> list[Message]:
    lidar = LidarModel(beams=180, dropouts=0.05)
    return list(Simulation("office", seed=3, duration=20.0, lidar=lidar, mount=(0.1, -0.05, 2.0)))


@pytest.mark.parametrize("per_metre", UNITS)
def test_unit_is_found_by_the_motion(office: list[Message], per_metre: float) -> None:
    scans = [
        replace(scan, readings=np.where(scan.readings > 100.0, scan.readings, 0.0))  # a lidar that sees no near objects
        for scan in scans_in_units(office, per_metre)
    ]
    found, report = find(scans)
    assert found == per_metre
    assert report.interpretations == [f"ranges in {UNITS[per_metre]}, converted to metres"]


def test_metres_are_kept(office: list[Message]) -> None:
    assert find(scans_in_units(office, 1.0)) == (1.0, SourceReport())


def test_ranges_that_cannot_be_metres_are_doubtful_if_the_robot_stands(office: list[Message]) -> None:
    standing = [replace(scan, pose=np.zeros(3)) for scan in scans_in_units(office, 1000.0)]
    found, report = find(standing)
    assert found == 1.0
    assert "not in metres" in report.doubts[0]


def test_far_no_returns_are_no_reason_for_doubt(office: list[Message]) -> None:
    far = [
        replace(scan, readings=np.where(np.arange(180) % 2, 1e4, scan.readings)) for scan in scans_in_units(office, 1.0)
    ]
    assert find(far) == (1.0, SourceReport())


@pytest.mark.parametrize(
    "limit", [pytest.param(40.0, marks=pytest.mark.slow), 40_000.0], ids=["limit in metres", "limit in millimetres"]
)
def test_bag_in_millimetres_is_read_in_metres(tmp_path: Path, office: list[Message], limit: float) -> None:
    in_millimetres = [
        replace(message, ranges=np.round(message.ranges * 1000.0), range_min=0.0, range_max=limit)
        if isinstance(message, Scan)
        else message
        for message in office
    ]
    write_bag1(tmp_path / "drive.bag", ros_entries(in_millimetres, RosEncoder()))
    source = drivers.open(tmp_path / "drive.bag", "forward")
    read = [message for message in source if isinstance(message, Scan)]
    for scan, original in zip(read, (m for m in office if isinstance(m, Scan)), strict=True):
        assert scan.ranges == pytest.approx(original.ranges, abs=0.00051, nan_ok=True)
        assert scan.range_max == 40.0
    assert source.report.interpretations == ["ranges in millimetres, converted to metres"]


def test_own_recording_in_millimetres_is_read_in_metres(tmp_path: Path, office: list[Message]) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for one in office:
            is_scan = isinstance(one, Scan)
            writer.write(replace(one, ranges=one.ranges * 1000.0, range_max=40_000.0) if is_scan else one)
    source = drivers.open(tmp_path / "drive.mcap", "forward")
    read = [message for message in source if isinstance(message, Scan)]
    for scan, original in zip(read, (m for m in office if isinstance(m, Scan)), strict=True):
        assert scan.ranges == pytest.approx(original.ranges, nan_ok=True)
        assert scan.range_max == 40.0
    assert source.report.interpretations == ["ranges in millimetres, converted to metres"]


@pytest.mark.parametrize("name", ["csail", "edmonton"])
def test_log_in_millimetres_is_read_in_metres(tmp_path: Path, name: str) -> None:
    lines = recording_file(name).read_text().splitlines()
    lines = lines[: len(lines) // 9]
    original, path = tmp_path / "original.clf", tmp_path / "log.clf"
    original.write_text("\n".join([*lines, ""]))
    with path.open("w") as file:
        for line in lines:
            words = line.split(" ")
            if words[0] == "FLASER":
                count = int(words[1])
                words[2 : 2 + count] = [f"{1000.0 * float(word):.0f}" for word in words[2 : 2 + count]]
            file.write(" ".join(words) + "\n")
    source = CarmenReader(path)
    scans, originals = ([m for m in reader if isinstance(m, Scan)] for reader in (source, CarmenReader(original)))
    assert scans
    for scan, same in zip(scans, originals, strict=True):
        assert scan.ranges == pytest.approx(same.ranges, abs=0.00051, nan_ok=True)
    assert source.report.interpretations == ["ranges in millimetres, converted to metres"]


def test_own_recordings_are_in_metres(recordings: dict[str, str]) -> None:
    source = McapReader(recordings["mcap"])
    list(source)
    assert (source.report.interpretations, source.report.doubts) == ([], [])


@pytest.mark.parametrize(
    "name",
    [
        "corridor/corridor.clf",
        "fhw/fhw.clf",
        "kidnapped/2018_may9_after1.bag",
        "lego/lego.clf",
        "mines/mines-1.clf",
        "slambot/slambot.clf",
        "turtlebot4/bag",
    ],
)
def test_public_recordings_have_no_false_alarms(name: str) -> None:
    source = drivers.open(dataset_file(name), "forward")
    list(source)
    assert (source.report.interpretations, source.report.doubts) == ([], [])
