"""Odometry from encoders that wrap, restart and send wrong readings."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from drivers.bases import DifferentialDrive, Odometer, WheelReading
from drivers.bases.create2 import WHEELS as CREATE2
from drivers.bases.kobuki import WHEELS as KOBUKI

PERIOD = 0.02
FINE = DifferentialDrive(left=1e-5, right=1.2e-5, track=0.3, bits=32, top_speed=0.5)


def drive(wheels: DifferentialDrive, count: int = 200) -> list[tuple[int, int]]:
    """Return counts, from zero, of a drive along bends at up to 0.4 m/s."""
    t = np.arange(count) * PERIOD
    left = np.cumsum(0.3 + 0.1 * np.sin(t)) * PERIOD / wheels.left
    right = np.cumsum(0.3 - 0.1 * np.cos(2 * t)) * PERIOD / wheels.right
    return [(round(a), round(b)) for a, b in zip(left, right, strict=True)]


def run(wheels: DifferentialDrive, counts: list[tuple[int, int]]) -> Odometer:
    odometer = Odometer(wheels)
    for i, (left, right) in enumerate(counts):
        odometer.add(WheelReading(left, right), i * PERIOD)
    return odometer


@pytest.mark.parametrize("wheels", [CREATE2, KOBUKI, FINE], ids=["create2", "kobuki", "fine"])
@settings(max_examples=40, deadline=None)
@given(left=st.integers(0, (1 << 32) - 1), right=st.integers(0, (1 << 32) - 1), as_signed=st.booleans())
def test_wraps_do_not_change_the_odometry(wheels: DifferentialDrive, left: int, right: int, as_signed: bool) -> None:
    counts = drive(wheels, 60)
    size = 1 << wheels.bits
    shift = size // 2 if as_signed else 0
    wrapped = [((a + left + shift) % size - shift, (b + right + shift) % size - shift) for a, b in counts]
    straight, across = run(wheels, counts), run(wheels, wrapped)
    assert np.array_equal(across.pose, straight.pose)
    assert np.array_equal(across.covariance, straight.covariance)
    assert across.counters == straight.counters
    assert across.counters.readings == len(counts)


def test_counts_of_16_bits_wrap() -> None:
    odometer = Odometer(CREATE2)
    odometer.add(WheelReading(65530, 65530), 0.0)
    message = odometer.add(WheelReading(4, 4), 0.015)
    assert message is not None
    assert_allclose(message.pose, [10 * CREATE2.left, 0, 0], atol=1e-12)


def test_counts_wrap_backwards() -> None:
    odometer = run(CREATE2, [(4, 4), (65534, 65532)])
    assert odometer.pose[0] == pytest.approx(-7 * CREATE2.left, rel=1e-4)


@pytest.mark.parametrize(("heading", "pause"), [(None, 1.5), (0.5, 3.0)])
def test_a_base_that_restarts_early_in_a_drive_has_not_driven_back(heading: float | None, pause: float) -> None:
    """In the time that a board takes to start, the robot could have returned: by the speed, both are possible."""
    odometer = Odometer(DifferentialDrive(left=2e-4, right=2e-4, track=0.3, bits=32, top_speed=1.5))
    for i in range(300):
        odometer.add(WheelReading(16 * i, 24 * i, heading=None if heading is None else heading * i / 300), i * PERIOD)
    before = odometer.pose.copy()
    uncertain = np.trace(odometer.covariance)
    for i in range(3):
        odometer.add(WheelReading(2 * i, 2 * i, heading=None if heading is None else 0.0), 300 * PERIOD + pause + i)
    assert odometer.counters.resets == 1
    assert np.hypot(*(odometer.pose - before)[:2]) == pytest.approx(4 * 2e-4)
    assert odometer.pose[2] == pytest.approx(before[2])
    assert np.trace(odometer.covariance) > uncertain


@pytest.mark.parametrize(
    ("before", "after", "pause"), [(5000, 5000, 2.0), (5000, 1000, 2.0), (300, 0, 2.0), (1000, 20, 0.2)]
)
def test_a_robot_may_stand_or_drive_back_while_its_base_is_silent(before: int, after: int, pause: float) -> None:
    """Not to zero, or not far, or in less time than a base needs to start."""
    odometer = Odometer(DifferentialDrive(left=2e-4, right=2e-4, track=0.3, bits=32, top_speed=1.5))
    odometer.add(WheelReading(0, 0), 0.0)
    odometer.add(WheelReading(before, before), 1.0)
    odometer.add(WheelReading(after, after), 1.0 + pause)
    assert odometer.pose[0] == pytest.approx(2e-4 * after)
    assert odometer.counters.resets == 0


@settings(max_examples=40, deadline=None)
@given(at=st.integers(1, 57))
def test_reset_loses_the_travel_between_two_readings_and_is_counted(at: int) -> None:
    counts = [(a + 100_000, b + 200_000) for a, b in drive(FINE, 60)]
    first = counts[at]
    restarted = counts[:at] + [(a - first[0], b - first[1]) for a, b in counts[at:]]
    odometer, whole = run(FINE, restarted), run(FINE, counts)
    assert odometer.counters.resets == 1
    assert odometer.counters.jumps == 0
    missing = (counts[at][0] - counts[at - 1][0]) * FINE.left, (counts[at][1] - counts[at - 1][1]) * FINE.right
    turn = abs(missing[1] - missing[0]) / FINE.track
    assert (
        np.hypot(*(odometer.pose - whole.pose)[:2]) < max(missing) + turn
    )  # the rest of the drive is shorter than a metre
    assert odometer.pose[2] - whole.pose[2] == pytest.approx(-(missing[1] - missing[0]) / FINE.track, abs=1e-9)
    assert np.all(np.diag(odometer.covariance) > np.diag(whole.covariance))


@settings(max_examples=40, deadline=None)
@given(at=st.integers(1, 58), left=st.integers(50_000, 1 << 30), right=st.integers(-(1 << 30), 1 << 30))
def test_a_single_wrong_reading_changes_nothing(at: int, left: int, right: int) -> None:
    counts = drive(FINE, 60)
    damaged = [*counts]
    damaged[at] = (left, right)
    odometer = run(FINE, damaged)
    assert odometer.counters.jumps == 1
    assert odometer.counters.resets == 0
    # one arc across the omitted reading is nearly equal to the two that it replaces
    assert_allclose(odometer.pose, run(FINE, counts).pose, atol=1e-3)


def test_a_suspect_reading_yields_no_message() -> None:
    odometer = run(FINE, drive(FINE, 10))
    assert odometer.add(WheelReading(10**8, 10**8), 10 * PERIOD) is None
    assert odometer.add(WheelReading(10**8 + 100, 10**8 + 100), 11 * PERIOD) is not None
    assert odometer.counters.resets == 1


def test_travel_in_a_pause_with_possible_wraps_is_unknown() -> None:
    odometer = Odometer(KOBUKI)
    odometer.add(WheelReading(0, 0), 0.0)
    message = odometer.add(WheelReading(20000, 20000), 3.0)
    assert message is not None
    assert message.pose[0] == 0.0
    assert odometer.counters.gaps == 1
    assert math.sqrt(odometer.covariance[0, 0]) == pytest.approx(0.7 * 3.0 / math.sqrt(3))
    short = Odometer(KOBUKI)
    short.add(WheelReading(0, 0), 0.0)
    short.add(WheelReading(8000, 8000), 1.5)
    assert short.pose[0] == pytest.approx(8000 * KOBUKI.left)
    assert short.counters.gaps == 0


def test_readings_out_of_order_are_omitted() -> None:
    odometer = run(FINE, [(0, 0), (10, 10)])
    assert odometer.add(WheelReading(20, 20), PERIOD) is None
    assert odometer.counters.disordered == 1
    odometer.add(WheelReading(30, 30), 2 * PERIOD)
    assert odometer.pose[0] == pytest.approx(30 * (FINE.left + FINE.right) / 2, rel=1e-3)


@settings(max_examples=40, deadline=None)
@given(start=st.floats(-math.pi, math.pi), slip=st.floats(0.5, 1.5))
def test_the_turn_is_that_of_the_gyro(start: float, slip: float) -> None:
    """The wheels slip in a bend; the gyro's heading wraps during two and a half turns."""
    odometer = Odometer(KOBUKI)
    for i in range(201):
        turned = 5 * math.pi * i / 200
        count = round(slip * turned * KOBUKI.track / 2 / KOBUKI.left)
        heading = math.remainder(start + turned, 2 * math.pi)
        odometer.add(WheelReading(-count % 65536, count, None, heading), i * PERIOD)
    assert abs(math.remainder(odometer.pose[2] - 5 * math.pi, 2 * math.pi)) < 1e-9
    assert odometer.counters.gyro_jumps == 0
    assert odometer.covariance[2, 2] == pytest.approx(200 * PERIOD * odometer.noise.gyro)


def test_a_jump_of_the_gyro_is_ignored() -> None:
    odometer = Odometer(KOBUKI)
    for i, heading in enumerate([1.0, 1.0, -2.0, -2.0]):
        odometer.add(WheelReading(100 * i, 100 * i, None, heading), i * PERIOD)
    assert odometer.counters.gyro_jumps == 1
    assert odometer.pose[2] == 0.0


def test_the_wheels_are_used_if_a_reading_has_no_heading() -> None:
    odometer = Odometer(KOBUKI)
    turn = 20 * KOBUKI.left / KOBUKI.track
    for i, heading in enumerate([0.5, None, 0.5, 0.5]):
        odometer.add(WheelReading(0, 20 * i, None, heading), i * PERIOD)
    assert odometer.pose[2] == pytest.approx(2 * turn)
