"""Stamps in milliseconds, microseconds and nanoseconds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from drivers import Message, Odometry, RecordingError, Scan, inspect
from drivers.recordings.carmen import CarmenReader

UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
COUNT = 300


def log(folder: Path, start: float, unit: float, *, period: float = 0.2, speed: float = 0.3) -> Path:
    """Write a log of a robot on a straight line, with stamps as whole numbers of a unit unless that is seconds."""
    lines = []
    for i in range(COUNT):
        x = 1.0 + speed * period * i
        stamp = (start + period * i) * unit
        text = f"{stamp:.6f}" if unit == 1.0 else f"{stamp:.0f}"
        lines.append(f"FLASER 3 1.0 2.0 3.0 {x:.3f} 0 0 {x:.3f} 0 0 {text} host {text}\n")
    path = folder / "log.clf"
    path.write_text("".join(lines))
    return path


def read(path: Path) -> tuple[list[Message], CarmenReader]:
    source = CarmenReader(path)
    return list(source), source


@pytest.mark.parametrize("start", [0.0, 12.5, 5e5, 1.7e9])
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("speed", [0.02, 0.3, 3.0])
def test_other_units_are_converted(tmp_path: Path, start: float, unit: str, speed: float) -> None:
    messages, source = read(log(tmp_path, start, UNITS[unit], speed=speed))
    scans = [message.stamp for message in messages if isinstance(message, Scan)]
    assert scans == pytest.approx(start + 0.2 * np.arange(COUNT), abs=1e-3)
    assert source.report.interpretations == [f"stamps in {unit}, converted to seconds"]
    assert source.report.skipped == 0


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize("period", [0.02, 1.0, 6.0, 40.0])
@pytest.mark.parametrize("speed", [0.05, 0.3])
def test_seconds_are_kept_also_if_scans_are_rare(tmp_path: Path, start: float, period: float, speed: float) -> None:
    messages, source = read(log(tmp_path, start, 1.0, period=period, speed=speed))
    scans = [message.stamp for message in messages if isinstance(message, Scan)]
    assert scans == pytest.approx(start + period * np.arange(COUNT))
    assert not source.report.interpretations
    assert not source.report.doubts


def test_a_recording_whose_sensors_stamp_in_different_units_is_not_mapped(tmp_path: Path) -> None:
    path = tmp_path / "log.clf"
    lines = [
        f"ODOM {0.02 * i:.2f} 0 0 0 0 0 {100.0 * i:.6f} host {100.0 * i:.6f}\n"
        + (f"FLASER 3 1.0 2.0 3.0 {0.02 * i:.2f} 0 0 0 0 0 {0.1 * i:.6f} host {0.1 * i:.6f}\n" if i % 2 else "")
        for i in range(COUNT)
    ]
    path.write_text("".join(lines))
    reason = r"\d+ of 150 scans cannot be used: do all sensors stamp in seconds\? \(.*log\.clf:\d+: stamp far from"
    with pytest.raises(RecordingError, match=rf"log\.clf: {reason}"):
        CarmenReader(path).check_scans()
    assert any(re.match(reason, text) for text in inspect(CarmenReader(path)).warnings)


def test_unit_without_motion_is_doubtful(tmp_path: Path) -> None:
    assert any("unit of the stamps" in text for text in inspect(read(log(tmp_path, 0.0, 1e3, speed=0.0))[1]).warnings)


def test_dates_need_no_motion(tmp_path: Path) -> None:
    messages, source = read(log(tmp_path, 1.7e9, 1e3, speed=0.0))
    assert messages[0].stamp == 1.7e9
    assert "milliseconds" in source.report.interpretations[0]
    assert source.report.doubts


def test_unit_is_recognised_if_the_robot_moves_late(tmp_path: Path) -> None:
    path = log(tmp_path, 0.0, 1e3)
    standing = "".join(f"FLASER 3 1 2 3 1 0 0 1 0 0 {stamp} host 0\n" for stamp in range(0, 40_000, 100))
    moving = log(tmp_path, 40.0, 1e3).read_text()
    path.write_text(standing + moving)
    messages, _ = read(path)
    assert isinstance(messages[-1], Scan)
    assert messages[-1].stamp == pytest.approx(40.0 + 0.2 * (COUNT - 1))


def test_messages_without_a_valid_stamp_are_skipped(tmp_path: Path) -> None:
    path = tmp_path / "log.clf"
    path.write_text("ODOM 0 0 0 0 0 0 1.0 host 0\nODOM 0 0 0 0 0 0 1e12 host 0\nODOM 0 0 0 0 0 0 1.1 host 0\n")
    messages, source = read(path)
    assert [message.stamp for message in messages if isinstance(message, Odometry)] == [1.0, 1.1]
    assert source.report.reasons == {"stamp is invalid": 1}
    assert source.report.first == f"{path}:2: stamp is invalid"
    path.write_text("ODOM 0 0 0 0 0 0 1e12 host 0\n" * 3)
    with pytest.raises(RecordingError, match="stamp is invalid"):
        read(path)
