"""Logs in which nearly all scans have one stamp: the lines' order is known, and their times are made up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import Message, Odometry, Scan
from drivers.recordings.reader import RecordingReader
from drivers.recordings.standing_clock import INTERVAL, LONGEST, SPEED, PathClock, clock_stands
from drivers.timing.delay import Delay

STEP = 0.3  # metres from scan to scan
READINGS = 4  # ODOM lines from scan to scan


def log(stamps: list[str]) -> list[str]:
    """Return the lines of a straight drive with one scan for each of the stamps, which its ODOM lines have too."""
    lines = []
    for k, stamp in enumerate(stamps):
        for x in k * STEP + STEP / READINGS * np.arange(1, READINGS + 1):
            lines.append(f"ODOM {x:.6f} 0 0 0 0 0 {stamp} host {stamp}")
        pose = f"{(k + 1) * STEP:.6f} 0 0"
        lines.append(f"FLASER 3 {1 + 0.01 * k:.2f} 1.1 1.2 {pose} {pose} {stamp} host {stamp}")
    return lines


def read(path: Path, lines: list[str]) -> tuple[list[Message], list[str]]:
    """Return the messages of a log, and what is doubtful about it."""
    path.write_text("\n".join(lines) + "\n")
    source = drivers.open(path)
    messages = list(source)
    assert not source.report.skipped
    return messages, source.report.doubts


def test_lines_are_timed_by_the_path(tmp_path: Path) -> None:
    for written in ("0", "1.01893e+09", "4.29497e+09"):
        messages, doubts = read(tmp_path / "standing.log", log([written] * 20))
        scans = [message for message in messages if isinstance(message, Scan)]
        odometry = [message for message in messages if isinstance(message, Odometry)]
        assert len(scans) == 20
        assert len(odometry) == 20 * READINGS  # those of the scans repeat the ODOM lines before them
        steps = np.diff([scan.stamp for scan in scans])
        np.testing.assert_allclose(steps, STEP / SPEED, atol=1e-6)
        x = [message.pose[0] for message in odometry]
        np.testing.assert_allclose(np.diff([message.stamp for message in odometry]), np.diff(x) / SPEED, atol=1e-6)
        assert any("same stamp" in text for text in doubts)


@pytest.mark.parametrize("stands", [True, False])
def test_made_up_times_show_no_delay_of_the_lidar(
    stands: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Delay(0.2, 0.01, None)
    monkeypatch.setattr("drivers.timing.delay.estimate_delay", lambda *_: found)
    path = tmp_path / "standing.log"
    path.write_text("\n".join(log(["0"] * 20 if stands else [f"{0.5 * k:.3f}" for k in range(20)])) + "\n")
    source = drivers.open(path)
    assert isinstance(source, RecordingReader)
    assert source.delay == (None if stands else found)


def test_stamps_that_are_invalid_do_not_matter(tmp_path: Path) -> None:
    written = ["-0.042", "-0.082", "nan", "3e-86", *["4.29497e+09"] * 20]
    messages, _ = read(tmp_path / "standing.log", log(written))
    assert sum(isinstance(message, Scan) for message in messages) == len(written)
    assert np.all(np.diff([message.stamp for message in messages]) >= 0.0)


def test_scans_of_a_robot_that_stands_differ_in_time() -> None:
    clock = PathClock()
    stamps = [clock.stamp(b"FLASER", np.zeros(3)) for _ in range(5)]
    np.testing.assert_allclose(stamps, INTERVAL * np.arange(5))
    assert clock.stamp(b"FLASER", np.array([1e6, 0.0, 0.0])) == stamps[-1] + LONGEST  # a jump, not a long drive


def test_stamps_of_other_logs_are_kept(tmp_path: Path) -> None:
    bursts = [f"{k // 3}.5" for k in range(30)]  # three scans of one stamp
    for stamps in ([f"{0.4 * k:.3f}" for k in range(30)], bursts, ["7.0"] * 5):
        assert not clock_stands([line.encode() for line in log(stamps)])
        messages, doubts = read(tmp_path / "kept.log", log(stamps))
        assert [message.stamp for message in messages if isinstance(message, Scan)] == [float(s) for s in stamps]
        assert not doubts
