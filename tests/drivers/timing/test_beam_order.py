"""The order of the beams' times is decided from the scans of a turning robot, and only if they show it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Odometry, Scan, with_reversed_times
from drivers.recordings.mcap import McapWriter
from drivers.timing.beam_order import decide_beam_order
from drivers.timing.turns import Turns

from ...recordings import dataset_file
from .drives import mirrored, office_drive


def with_reversed_scans(drive: tuple[Message, ...]) -> list[Message]:
    return [with_reversed_times(message) if isinstance(message, Scan) else message for message in drive]


@pytest.mark.parametrize("clockwise", [False, True])
def test_order_is_found_for_both_directions_of_rotation(clockwise: bool) -> None:
    drive = mirrored(office_drive()) if clockwise else office_drive()
    assert decide_beam_order(Turns(drive)).order == "forward"
    assert decide_beam_order(Turns(with_reversed_scans(drive))).order == "reversed"


def test_order_is_found_without_odometry() -> None:
    scans = tuple(message for message in office_drive() if isinstance(message, Scan))
    assert decide_beam_order(Turns(scans)).order == "forward"
    assert decide_beam_order(Turns(with_reversed_scans(scans))).order == "reversed"


def test_odometry_that_begins_late_finds_the_turns() -> None:
    drive = office_drive()
    late = [message for message in drive if isinstance(message, Scan) or message.stamp > drive[0].stamp + 15.0]
    first = next(message.stamp for message in late if isinstance(message, Odometry))
    runs = Turns(late).runs
    assert runs
    assert all(run.scans[-1].stamp > first for run in runs)


def test_nothing_is_said_of_a_robot_that_does_not_turn() -> None:
    scans = [message for message in office_drive() if isinstance(message, Scan)]
    assert decide_beam_order(Turns(replace(scans[0], stamp=scan.stamp) for scan in scans)).order is None
    assert decide_beam_order(Turns(drivers.open("sim:corridor?duration=15&lidar=short"))).order is None
    assert decide_beam_order(Turns([])).order is None


def test_reversed_times_cover_the_same_sweep() -> None:
    scan = next(message for message in office_drive() if isinstance(message, Scan))
    other = with_reversed_times(scan)
    np.testing.assert_allclose(other.time_offsets, scan.time_offsets[::-1], atol=1e-12)
    np.testing.assert_allclose(with_reversed_times(other).time_offsets, scan.time_offsets, atol=1e-12)


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


def test_public_recording_with_reversed_times_is_recognised() -> None:
    reader = drivers.source_factory.recording_of(drivers.open(dataset_file("turtlebot4/bag")))
    assert reader is not None
    assert reader.beams_reversed
