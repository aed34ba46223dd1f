"""Logs that GMapping has written: the wheels' odometry is restored from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.recordings.gmapping_logs import remove_estimates

STEP = np.array([0.05, 0.0, 0.03])  # metres and radians between two ODOM lines
ERROR = np.array([0.02, -0.01, 0.04])  # of the motion from scan to scan, which GMapping corrects
BETWEEN_SCANS = 10  # ODOM lines


def drive(*, scans: int) -> list[np.ndarray]:
    """Return the wheels' odometry (3,) for each line."""
    poses = [np.array([0.3, -0.2, 0.1])]
    for _ in range(scans * BETWEEN_SCANS - 1):
        poses.append(se2.compose(poses[-1], STEP))
    return poses


def text(pose: np.ndarray) -> str:
    return " ".join(f"{value:.9f}" for value in pose)


def gmapping_log(odometry: list[np.ndarray], stamp: str) -> list[str]:
    """Return the log that GMapping writes if each of its estimates corrects ERROR; `stamp`: of the estimates."""
    lines, estimate, at_estimate = [], odometry[0], odometry[0]
    for k, pose in enumerate(odometry):
        time = f"{0.1 * k:.3f}"
        lines.append(f"ODOM {text(se2.compose(estimate, se2.between(at_estimate, pose)))} 0 0 0 {time} host {time}")
        if k % BETWEEN_SCANS == BETWEEN_SCANS - 1:
            estimate = se2.compose(se2.compose(estimate, se2.between(at_estimate, pose)), ERROR)
            at_estimate = pose
            shown = text(estimate)
            lines += [
                f"FLASER 3 1.0 1.1 1.2 {shown} {shown} {time} host {time}",
                f"ODOM {shown} 0 0 0 {stamp} host {stamp}",
                "NEFF 30",
            ]
    return lines


def test_odometry_of_the_wheels_is_restored(tmp_path: Path) -> None:
    odometry = drive(scans=5)
    for stamp in ("0", "4.85e-86", "1e300", "nan"):  # GMapping does not set it
        log = tmp_path / "corrected.log"
        log.write_text("\n".join(gmapping_log(odometry, stamp)) + "\n")
        source = drivers.open(log)
        messages = list(source)
        read = [message for message in messages if isinstance(message, Odometry)]
        np.testing.assert_allclose([message.pose for message in read], odometry, atol=1e-7)
        np.testing.assert_allclose([message.stamp for message in read], 0.1 * np.arange(len(odometry)), atol=1e-9)
        assert sum(isinstance(message, Scan) for message in messages) == 5
        assert not source.report.skipped
        assert any("written by GMapping" in text for text in source.report.interpretations)


def test_other_logs_are_read_as_they_are() -> None:
    """A scan has the pose of the odometry before it, and of that after it while the robot stands still."""
    lines = []
    for k, pose in enumerate(drive(scans=3)):
        shown, moved = text(pose), text(se2.compose(pose, STEP))
        after = moved if k % 5 == 0 else shown
        lines += [f"ODOM {shown} 0 0 0 {k} host {k}", f"FLASER 2 1.0 1.1 {shown} {shown} {k} host {k}"]
        lines += [f"ODOM {after} 0 0 0 {k + 0.5} host {k + 0.5}"]
    encoded = [line.encode() for line in lines]
    kept = list(encoded)
    assert not remove_estimates(kept)
    assert kept == encoded


@pytest.mark.parametrize("count", ["", "2.5", "-1", 5000 * "7"])
def test_invalid_numbers_of_beams_are_no_estimates(count: str) -> None:
    lines = [f"ODOM 0 0 0 0 0 0 1 host 1\nFLASER {count} 1.0 1.1 1 0 0 0 0 0 2 host 2\n".encode()]
    assert not remove_estimates(lines[0].splitlines(keepends=True))


def test_estimates_are_kept_if_there_is_no_other_odometry() -> None:
    """The log that GMapping writes of a log without ODOM lines: nothing else tells how the robot moved."""
    lines = []
    for k, pose in enumerate(drive(scans=3)):
        shown = text(pose)
        lines += [f"FLASER 2 1.0 1.1 {shown} {shown} {k} host {k}", f"ODOM {shown} 0 0 0 0 host 0", "NEFF 30"]
    encoded = [line.encode() for line in lines]
    kept = list(encoded)
    assert not remove_estimates(kept)
    assert kept == encoded


def test_estimates_are_the_odometry_where_there_is_no_other(tmp_path: Path) -> None:
    """Readings of the odometry can be lost for some seconds, in which the robot turns."""
    lost = slice(2 * (BETWEEN_SCANS + 3), 3 * (BETWEEN_SCANS + 3) - 3)  # from one scan to the next
    odometry = drive(scans=5)
    lines = gmapping_log(odometry, "0")
    assert sum(line.startswith("ODOM") for line in lines[lost]) == BETWEEN_SCANS
    del lines[lost]
    log = tmp_path / "corrected.log"
    log.write_text("\n".join(lines) + "\n")
    read = [message.pose for message in drivers.open(log) if isinstance(message, Odometry)]
    motion = se2.between(odometry[2 * BETWEEN_SCANS - 1], odometry[3 * BETWEEN_SCANS - 1])
    np.testing.assert_allclose(
        se2.between(read[2 * BETWEEN_SCANS - 1], read[2 * BETWEEN_SCANS]), se2.compose(motion, ERROR), atol=1e-7
    )
    end = se2.between(odometry[3 * BETWEEN_SCANS - 1], odometry[-1])
    np.testing.assert_allclose(se2.between(read[2 * BETWEEN_SCANS], read[-1]), end, atol=1e-7)


def test_a_log_may_end_with_a_scan(tmp_path: Path) -> None:
    """The estimate of the last scan is not repeated if the log was cut short there."""
    odometry = drive(scans=5)
    log = tmp_path / "corrected.log"
    log.write_text("\n".join(gmapping_log(odometry, "0")[:-2]) + "\n")
    read = [message.pose for message in drivers.open(log) if isinstance(message, Odometry)]
    np.testing.assert_allclose(read, odometry, atol=1e-7)
