"""Odometry of a session as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slam.io.sessions.odometry import read_odometry, write_odometry
from slam.odometry.history import BLOCK, OdometryHistory

from ...traced_memory import traced_memory


def history(readings: int, begin: float = 0.0) -> OdometryHistory:
    stamps = begin + 0.02 * np.arange(readings)
    return OdometryHistory.from_arrays(stamps, np.column_stack([stamps, stamps + 1.0, np.sin(stamps)]))


@pytest.mark.parametrize("lengths", [[], [0], [7], [10], [23, 10, 1]])
def test_all_readings_of_each_segment_are_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lengths: list[int]
) -> None:
    monkeypatch.setattr("slam.odometry.history.BLOCK", 10)
    written = [history(length, 100.0 * k) for k, length in enumerate(lengths)]
    write_odometry(tmp_path / "odometry.parquet", written)
    read = read_odometry(tmp_path / "odometry.parquet")
    assert [len(segment) for segment in read] == [length for length in lengths if length]
    for segment, expected in zip(read, written, strict=False):
        np.testing.assert_array_equal(segment.stamps, expected.stamps)
        np.testing.assert_array_equal(segment.poses, expected.poses)


def test_the_memory_to_write_odometry_does_not_grow_with_the_drive(tmp_path: Path) -> None:
    """A live run saves its record every 45 seconds, for days."""

    def needed(readings: int) -> int:
        written = [history(readings)]
        with traced_memory() as memory:
            write_odometry(tmp_path / "odometry.parquet", written)
        return memory.peak

    needed(100)  # imports
    assert needed(8 * BLOCK) < 1.1 * needed(4 * BLOCK)
