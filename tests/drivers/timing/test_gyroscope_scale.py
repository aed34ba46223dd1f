"""Rates of a gyroscope in degrees, of one that is upside down, and of one that measures something else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Odometry, Scan, YawRate
from drivers.recordings.mcap import McapWriter
from drivers.timing.gyroscope_scale import GyroscopeScale, estimate_gyroscope_scale
from drivers.timing.turn_scale import TurnScale
from drivers.timing.turns import Turns

from .drives import office_drive

DEGREES = 180.0 / np.pi
BIAS = 0.02
"""Radians per second."""


def with_rates(scale: float, *, wheels: bool = True) -> list[Message]:
    """Return a drive with rates that are `scale` times those of the robot in radians per second, and a bias."""
    drive: list[Message] = []
    before: Odometry | None = None
    for message in office_drive():
        if isinstance(message, Odometry):
            if before is not None:
                interval = message.stamp - before.stamp
                turn = float(np.angle(np.exp(1j * (message.pose[2] - before.pose[2]))))
                drive.append(YawRate(0.5 * (message.stamp + before.stamp), scale * turn / interval + BIAS))
            before = message
        if wheels or isinstance(message, Scan):
            drive.append(message)
    return sorted(drive, key=lambda message: message.stamp)


def rates_of(messages: Sequence[Message]) -> list[float]:
    return [message.rate for message in messages if isinstance(message, YawRate)]


@pytest.mark.parametrize("wheels", [True, False])
@pytest.mark.parametrize("scale", [1.0, -1.0, DEGREES, -DEGREES])
def test_unit_and_direction_are_found(scale: float, wheels: bool) -> None:
    found = estimate_gyroscope_scale(Turns(with_rates(scale, wheels=wheels)))
    assert found is not None
    assert found.used == scale
    assert found.turns.found == pytest.approx(scale, rel=0.05)


def test_rates_of_another_axis_measure_nothing() -> None:
    found = estimate_gyroscope_scale(Turns(with_rates(0.01)))
    assert found is not None
    assert found.used is None
    assert rates_of(list(found.converted(with_rates(0.01)))) == []


@pytest.mark.parametrize(
    ("found", "sigma", "used"),
    [(-60.0, 20.0, 1.0), (-60.0, 2.0, -DEGREES), (0.0, 0.2, 1.0), (8.0, 0.01, None), (1.3, 0.001, 1.0)],
)
def test_an_uncertain_scale_changes_nothing(found: float, sigma: float, used: float | None) -> None:
    assert GyroscopeScale(TurnScale(found, sigma, 20)).used == used


def test_nothing_is_found_without_rates_or_turns() -> None:
    assert estimate_gyroscope_scale(Turns(office_drive())) is None
    assert estimate_gyroscope_scale(Turns([])) is None


def test_recorded_rates_are_converted_and_that_is_stated(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in with_rates(-DEGREES):
            writer.write(message)
    source = drivers.open(str(tmp_path / "drive.mcap"))
    np.testing.assert_allclose(rates_of(list(source)), np.array(rates_of(with_rates(-DEGREES))) / -DEGREES)
    assert any("degrees per second clockwise" in line for line in source.report.interpretations)
    assert any("opposite directions" in line for line in source.report.doubts)


def test_correct_rates_are_read_as_they_are(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in with_rates(1.0):
            writer.write(message)
    source = drivers.open(str(tmp_path / "drive.mcap"))
    np.testing.assert_array_equal(rates_of(list(source)), rates_of(with_rates(1.0)))
    assert not source.report.interpretations
    assert not source.report.doubts
