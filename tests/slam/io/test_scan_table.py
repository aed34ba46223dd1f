"""Scans of a session as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from slam.io.sessions.scans import ScanRecords, read_scans, write_recent_keyframes, write_scans
from slam.mapping.trajectory_builder import TrajectoryBuilder
from slam.preprocessing.preprocessor import NO_FEATURES, ProcessedScan
from slam.preprocessing.scan_sequence import ScanSequence

from ...traced_memory import traced_memory

RECORD = 40 + 112
"""Bytes of a scan without features, and of its pose on the trajectory."""


def records(count: int) -> ScanRecords:
    """Return the records of scans in a familiar place."""
    scans, trajectory = ScanSequence(), TrajectoryBuilder()
    for stamp in map(float, range(count)):
        scans.append(ProcessedScan(stamp, np.zeros(3), NO_FEATURES, 0.0))
        trajectory.add(stamp, 0, np.zeros(3), np.eye(3))
    return ScanRecords(scans, trajectory, [], [])


def test_scans_to_which_odometry_does_not_lead_are_stored(tmp_path: Path) -> None:
    flags = [True, True, False, True]
    scans = ScanSequence(ProcessedScan(0.1, np.zeros(3), NO_FEATURES, measured=measured) for measured in flags)
    written = ScanRecords(scans, TrajectoryBuilder(), [], [])
    write_scans(tmp_path / "scans.parquet", written)
    write_recent_keyframes(tmp_path / "recent.parquet", written)
    read = read_scans(tmp_path / "scans.parquet", tmp_path / "recent.parquet").scans
    assert read.measured.tolist() == [scan.measured for scan in read] == flags


def test_to_write_scans_takes_less_memory_than_a_copy_of_their_record(tmp_path: Path) -> None:
    def needed(count: int) -> int:
        written = records(count)
        with traced_memory() as memory:
            write_scans(tmp_path / "scans.parquet", written)
        return memory.peak

    needed(10)  # imports
    assert needed(12_000) - needed(4_000) < 0.5 * RECORD * 8_000
