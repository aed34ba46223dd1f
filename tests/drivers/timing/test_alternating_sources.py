"""Scans of two robots on one topic are recognised, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Scan, SourceReport
from drivers.recordings.mcap import McapWriter
from drivers.timing.alternating_sources import AlternatingSources
from drivers.timing.watched_view import watched

from .room_views import drive, room, spinning

ROOM = room(9.0, 7.0)


def driving() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the path (n, 3) of a robot that turns and drives."""
    turning = spinning()
    return np.asarray(turning + np.column_stack([np.linspace(-3.0, 3.0, len(turning)), *np.zeros((2, len(turning)))]))


def scans(path: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> list[Scan]:
    return [message for message in drive(ROOM, path) if isinstance(message, Scan)]


def merged(every: int = 1) -> list[Scan]:
    """Return the scans of a robot that drives, and one of so many of another that stands elsewhere."""
    standing = scans(np.tile([3.5, 2.5, 1.0], (len(driving()), 1)))[::every]
    late = [replace(scan, stamp=scan.stamp + 0.001) for scan in standing]
    return sorted([*scans(driving()), *late], key=lambda scan: scan.stamp)


def found(messages: Iterable[Message]) -> str | None:
    detector = AlternatingSources()
    for message in messages:
        detector.add(message)
    return detector.describe()


@pytest.mark.parametrize("every", [1, 2, 3])
def test_two_robots_on_one_topic_are_found(every: int) -> None:
    text = found(merged(every))
    assert text is not None
    assert text.startswith("the scans are of two sources, as two robots or programs that publish on one topic: ")


def with_bad_scans(views: list[Scan]) -> list[Scan]:
    """Return scans of which every third shows ranges that are too short, each by another factor."""
    factors = np.random.default_rng(0).uniform(0.2, 0.8, len(views))
    return [
        replace(scan, ranges=scan.ranges * factor) if k % 3 == 1 else scan
        for k, (scan, factor) in enumerate(zip(views, factors, strict=True))
    ]


def with_other_angles(views: list[Scan]) -> list[Scan]:
    """Return scans of which every second is measured between the beams of the others."""
    return [replace(scan, angles=scan.angles + np.radians(0.5)) if k % 2 else scan for k, scan in enumerate(views)]


def of_two_mounts() -> list[Scan]:
    return [replace(scan, mount=np.array([0.1 * (k % 2), 0.0, 0.0])) for k, scan in enumerate(merged())]


@pytest.mark.parametrize(
    "views",
    [
        pytest.param(lambda: scans(driving()), id="driving"),
        pytest.param(lambda: scans(driving())[::7], id="few scans"),
        pytest.param(lambda: scans(np.zeros((100, 3))), id="standing"),
        pytest.param(lambda: with_other_angles(scans(driving())), id="interlaced"),
        pytest.param(lambda: with_bad_scans(scans(np.zeros((200, 3)))), id="bad scans"),
        pytest.param(of_two_mounts, id="two lidars"),
        pytest.param(lambda: [replace(scan, ranges=np.full(360, np.nan)) for scan in merged()], id="no returns"),
        pytest.param(list, id="nothing"),
    ],
)
def test_one_robot_is_not(views: Callable[[], list[Scan]]) -> None:
    assert found(views()) is None


def test_a_recording_and_a_live_run_report_it(tmp_path: Path) -> None:
    path, report = tmp_path / "drive.mcap", SourceReport()
    with McapWriter(path) as writer:
        for message in watched(merged(), report, (0.1, 12.0)):
            writer.write(message)
    source = drivers.open(path)
    assert sum(isinstance(message, Scan) for message in source) == len(merged())
    assert source.report.doubts == report.doubts
    assert report.doubts[0].startswith("the scans are of two sources")
