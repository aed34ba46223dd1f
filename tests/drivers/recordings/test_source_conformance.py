"""Contract of all sources, whatever their format."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import drivers
from drivers import GroundTruth, Message, Odometry, Scan, Source, SourceReport
from drivers.source_factory import recording_of

KINDS = ["carmen", "carmen-gzip", "carmen-bzip2", "mcap", "ros1-bag", "ros2-sqlite3", "ros2-mcap", "simulation"]


@pytest.fixture(params=KINDS)
def source(request: pytest.FixtureRequest, recordings: dict[str, str]) -> Source:
    return drivers.open(recordings[request.param])


def test_source_has_a_name_and_a_report(source: Source) -> None:
    assert isinstance(source, Source)
    assert source.name
    assert isinstance(source.report, SourceReport)


def test_every_iteration_yields_the_same_messages(
    source: Source, assert_same: Callable[[list[Message], list[Message]], None]
) -> None:
    assert_same(list(source), list(source))


def test_reading_ahead_changes_neither_messages_nor_report(
    source: Source, assert_same: Callable[[list[Message], list[Message]], None]
) -> None:
    """What is known of a whole recording before it is iterated takes a reading of its own, which is used again."""
    messages, report = list(source), source.report
    if (reader := recording_of(source)) is not None:
        assert reader.has_odometry
        assert reader.report is report
    assert_same(list(source), messages)
    assert source.report == report
    assert_same(list(source), messages)
    assert source.report == report


def test_what_is_known_ahead_and_the_first_iteration_take_one_reading(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    if (reader := recording_of(source)) is None:
        pytest.skip("a simulation is not read")
    readings, read = [], type(reader)._read
    monkeypatch.setattr(type(reader), "_read", lambda self: readings.append(self) or read(self))
    reader.check_scans()
    assert reader.has_odometry
    assert list(source)
    assert len(readings) == 1


def test_two_iterations_can_run_at_the_same_time(source: Source) -> None:
    for one, other in zip(source, source, strict=True):
        assert one.stamp == other.stamp


def test_stamps_never_decrease(source: Source) -> None:
    stamps = [message.stamp for message in source]
    assert all(isinstance(stamp, float) and np.isfinite(stamp) for stamp in stamps)
    assert stamps == sorted(stamps)


def test_all_messages_of_the_drive_are_read(source: Source) -> None:
    messages = list(source)
    assert sum(isinstance(message, Scan) for message in messages) == 29
    assert sum(isinstance(message, Odometry) for message in messages) >= 76
    assert len(source) == pytest.approx(len(messages), rel=0.3)


def test_scans_are_well_formed(source: Source) -> None:
    for scan in (message for message in source if isinstance(message, Scan)):
        n = len(scan.ranges)
        assert n > 0
        for values in (scan.ranges, scan.angles, scan.time_offsets):
            assert values.dtype == np.float64
            assert values.shape == (n,)
        assert np.all(np.diff(scan.angles) > 0)
        assert np.all(np.isfinite(scan.angles))
        assert np.all(np.isfinite(scan.time_offsets))
        valid = scan.ranges[~np.isnan(scan.ranges)]
        assert 0 < len(valid) < n
        assert np.all((valid >= scan.range_min) & (valid <= scan.range_max) & (valid > 0))
        assert type(scan.range_min) is float
        assert type(scan.range_max) is float
        assert scan.mount is not None
        assert scan.mount.shape == (3,)
        assert scan.mount.dtype == np.float64


def test_poses_are_well_formed(source: Source) -> None:
    for message in source:
        if isinstance(message, Odometry | GroundTruth):
            assert message.pose.shape == (3,)
            assert message.pose.dtype == np.float64
            assert np.all(np.isfinite(message.pose))
            assert -np.pi <= message.pose[2] <= np.pi


def test_report_is_complete_after_the_iteration(source: Source) -> None:
    messages = list(source)
    assert source.report.messages == len(messages)
    assert source.report.skipped == 0
    assert source.report.first is None
    list(source)
    assert source.report.messages == len(messages)


def test_writing_to_a_message_does_not_change_others(
    source: Source, assert_same: Callable[[list[Message], list[Message]], None]
) -> None:
    """Shared arrays are read-only; all others belong to one message."""
    first = list(source)
    for message in first:
        arrays = (
            (message.ranges, message.angles, message.time_offsets) if isinstance(message, Scan) else (message.pose,)
        )
        for array in arrays:
            if array.flags.writeable:
                array[:] = -1.0
    untouched = list(source)
    assert all(message.stamp >= 0 for message in untouched)
    for scan in (message for message in untouched if isinstance(message, Scan)):
        assert np.all(np.diff(scan.angles) > 0)
        assert np.all(scan.time_offsets >= 0)
