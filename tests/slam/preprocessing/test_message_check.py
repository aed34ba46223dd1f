"""Messages that the pipeline refuses, in one line, and those that it converts."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.messages import GroundTruth, InitialPose, Message, Odometry, Scan, YawRate
from drivers.simulation import LidarModel, Simulation
from slam import Slam
from slam.errors import MapError, MessageError
from slam.preprocessing.message_check import MAX_STEP_BACK, MessageCheck

BEAMS = 8
SCAN = Scan(5.0, np.full(BEAMS, 2.0), np.linspace(-3.0, 3.0, BEAMS), np.zeros(BEAMS), 0.1, 12.0)
POSE = np.array([1.0, 2.0, 3.0])


def scan(**changes: Any) -> Scan:
    return replace(SCAN, **changes)


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (scan(ranges=SCAN.ranges[1:]), "scan at 5.000 s: 7 ranges, 8 angles and 8 time offsets"),
        (scan(ranges=SCAN.ranges[:, None]), r"ranges must be one row of numbers, not an array of the shape \(8, 1\)"),
        (scan(ranges=[[1.0], [1.0, 2.0]]), "ranges must be an array of numbers, not list"),
        (scan(time_offsets=None), "time_offsets must be an array of numbers, not NoneType"),
        (scan(time_offsets=SCAN.ranges * np.nan), "the time offsets must be finite"),
        (scan(time_offsets=np.linspace(0.0, 100.0, BEAMS)), "up to 100 s from the stamp to a beam, .* in seconds"),
        (scan(angles=SCAN.angles * np.nan), "the angles must be finite"),
        (scan(angles=SCAN.angles[::-1]), "the angles must increase"),
        (scan(angles=np.degrees(SCAN.angles)), "the angles span 343.8, .* they must be in radians"),
        (scan(intensities=np.zeros(3)), "8 ranges, but 3 intensities"),
        (scan(range_max=None), "range_max must be a number of metres, not None"),
        (scan(mount=np.zeros(2)), "mount must be 3 numbers: x, y, heading; there are 2"),
        (scan(lidar=2), "the lidar must be 0, the first, or 1, the second, not 2"),
        (scan(stamp=np.nan), "scan: the stamp must be a number of seconds, not nan"),
        (scan(stamp="5"), "scan: the stamp must be a number of seconds, not '5'"),
        (scan(stamp=1.7e12), "scan: the stamp must be a number of seconds"),
        (Odometry(5.0, POSE[:2]), "odometry at 5.000 s: pose must be 3 numbers: x, y, heading; there are 2"),
        (Odometry(5.0, np.array([1.0, np.nan, 0.0])), r"the pose must be finite, .* not \[1.0, nan, 0.0\]"),
        (Odometry(5.0, np.array(["1", "2", "3"])), "pose must be an array of numbers"),
        (YawRate(5.0, np.inf), "yaw rate at 5.000 s: the rate must be a finite number"),
        (InitialPose(5.0, POSE[None]), "initial pose at 5.000 s: pose must be one row of numbers"),
        (GroundTruth(5.0, POSE * np.inf), "ground truth at 5.000 s: the pose must be finite"),
        ((5.0, POSE), "a message must be a Scan, .* not of type tuple"),
    ],
)
def test_a_message_that_cannot_be_used_is_refused_in_one_line(message: Message, problem: str) -> None:
    with pytest.raises(MessageError, match=problem) as raised:
        MessageCheck().checked(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("convert", [list, tuple, np.float32, lambda values: values.astype(np.int32)])
def test_lists_and_other_types_of_numbers_become_arrays_of_float64(convert: Callable[[Any], Any]) -> None:
    values = np.arange(float(BEAMS))
    given = scan(**dict.fromkeys(("ranges", "angles", "time_offsets", "intensities"), convert(values)))
    checked = MessageCheck().checked(replace(given, mount=convert(values[:3])))
    assert isinstance(checked, Scan)
    for array in (checked.ranges, checked.angles, checked.time_offsets, checked.intensities):
        assert array is not None
        assert array.dtype == np.float64
        assert np.array_equal(array, values)
    pose = MessageCheck().checked(Odometry(0.0, convert(values[:3])))
    assert isinstance(pose, Odometry)
    assert pose.pose.dtype == np.float64


def test_arrays_may_be_used_for_the_next_measurement() -> None:
    """A scan waits until odometry covers its sweep."""
    ranges, pose = SCAN.ranges.copy(), POSE.copy()
    checked, reading = MessageCheck().checked(scan(ranges=ranges)), MessageCheck().checked(Odometry(0.0, pose))
    ranges[:], pose[:] = 0.0, 0.0
    assert isinstance(checked, Scan)
    assert isinstance(reading, Odometry)
    assert np.array_equal(checked.ranges, SCAN.ranges)
    assert np.array_equal(reading.pose, POSE)


def test_a_message_that_cannot_change_is_passed_on_as_it_is() -> None:
    arrays = {name: getattr(SCAN, name).copy() for name in ("ranges", "angles", "time_offsets")}
    for array in arrays.values():
        array.flags.writeable = False
    for same in (scan(**arrays), scan(**dict.fromkeys(arrays, arrays["ranges"][:0]))):
        assert MessageCheck().checked(same) is same


@pytest.mark.parametrize("message", [SCAN, Odometry(5.0, POSE), YawRate(5.0, 0.1)])
def test_messages_of_a_sensor_must_be_in_time_order(message: Scan | Odometry | YawRate) -> None:
    check = MessageCheck()
    check.checked(message)
    check.checked(replace(message, stamp=message.stamp - MAX_STEP_BACK))
    with pytest.raises(MessageError, match=r"at 3\.900 s: it follows one at 5\.000 s"):
        check.checked(replace(message, stamp=3.9))


def test_sensors_may_be_late_against_each_other() -> None:
    check = MessageCheck()
    check.checked(Odometry(50.0, POSE))
    check.checked(SCAN)
    check.checked(scan(stamp=2.0, lidar=1))
    check.checked(InitialPose(0.0, POSE))  # a person may have set it long before


def test_stamps_of_two_clocks_are_refused() -> None:
    check = MessageCheck()
    check.checked(Odometry(1.7e9, POSE))
    with pytest.raises(MessageError, match=r"odometry is stamped 1700000000\.000 s, so both are not seconds of one"):
        check.checked(SCAN)


def test_the_clock_of_all_sensors_may_be_set_ahead_by_months() -> None:
    """As that of a computer without a battery-backed clock is when it gets the time from the network."""
    check = MessageCheck()
    for stamp in (1.6e9, 1.7e9):
        check.checked(Odometry(stamp, POSE))
        check.checked(scan(stamp=stamp))


def drive(duration: float = 12.0) -> list[Message]:
    return [m for m in Simulation("room", duration=duration, lidar=LidarModel(beams=90)) if not is_truth(m)]


def is_truth(message: Message) -> bool:
    return isinstance(message, GroundTruth)


def with_ranges(messages: list[Message], change: Callable[[Any], Any], **limits: float) -> list[Message]:
    return [replace(m, ranges=change(m.ranges), **limits) if isinstance(m, Scan) else m for m in messages]


IN_WRONG_UNITS = {
    "millimetres": (lambda m: with_ranges(m, lambda r: 1000.0 * r), "nearly all ranges are beyond 100: .* in metres"),
    "integers, zero without return": (
        lambda m: with_ranges(m, lambda r: np.nan_to_num(1000.0 * r).astype(np.uint16), range_max=65535.0),
        "nearly all ranges are beyond 100: .* divide millimetres by 1000",
    ),
    "milliseconds": (
        lambda m: [replace(one, stamp=1e3 * one.stamp) for one in m],
        "the stamps are in milliseconds, by the speed of the robot: they must be in seconds; divide by 1000",
    ),
}


@pytest.mark.parametrize("case", IN_WRONG_UNITS)
def test_wrong_units_are_named_once_and_early(case: str) -> None:
    change, problem = IN_WRONG_UNITS[case]
    check, refused = MessageCheck(), []
    messages = change(drive())
    for index, message in enumerate(messages):
        try:
            check.checked(message)
        except MessageError as error:
            refused.append((index, str(error)))
    ((index, text),) = refused
    assert re.search(problem, text)
    assert index < len(messages) / 2
    check.finish()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda ranges: 1000.0 * ranges, "nearly all ranges are beyond 100"),
        (lambda ranges: ranges / 1000.0, r"no range of 9 scans is between range_min \(0.1\) and range_max \(40\)"),
    ],
)
def test_the_end_of_a_short_run_names_wrong_units(change: Callable[[Any], Any], problem: str) -> None:
    slam = Slam()
    for message in with_ranges(drive(1.0), change):
        slam.add(message)
    with pytest.raises(MapError, match=problem):
        slam.finish()


def test_a_large_number_for_no_returns_is_no_unit() -> None:
    check = MessageCheck()
    for message in with_ranges(drive(), lambda ranges: np.where(np.arange(len(ranges)) % 20, 9999.0, ranges)):
        check.checked(message)
    check.finish()


def test_a_run_goes_on_after_a_message_that_was_refused() -> None:
    messages = list(Simulation("room", seed=1, duration=4.0, lidar=LidarModel(beams=90)))
    slam, undisturbed = Slam(), Slam()
    for message in messages:
        undisturbed.add(message)
        slam.add(message)
        if isinstance(message, Scan):
            with pytest.raises(MessageError):
                slam.add(replace(message, ranges=message.ranges[:-1], stamp=message.stamp + 2.0))
    assert np.array_equal(slam.finish().poses, undisturbed.finish().poses)
