"""Check of the messages that the pipeline is given, so that an error of a user's program is named where it is made."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.messages import MAX_SPAN, MAX_TURN_PERIOD, GroundTruth, InitialPose, Message, Odometry, Scan, YawRate
from drivers.recordings.stamp_units import MAX_STAMP

from ..bounds import MAX_LENGTH
from ..errors import MapError, MessageError
from ..geometry.segments import Floats
from .unit_check import UnitCheck

# Seconds by which a message may be earlier than the one before of its sensor. Origin: as in recordings, whose messages
# are sorted within a second; more than the jitter of any stamps.
MAX_STEP_BACK = 1.0
# Seconds between the stamps of two sensors above which they are not of one clock, or not both in seconds.
# Origin: chosen, some months; no device is silent for as long in one run.
MAX_APART = 1e7
# Names of the messages in texts.
NAMES = {
    Scan: "scan",
    Odometry: "odometry",
    YawRate: "yaw rate",
    InitialPose: "initial pose",
    GroundTruth: "ground truth",
}
# Kinds of NumPy's types that are real numbers.
NUMBERS = "biuf"
# Types whose stamps must follow each other: a person may set the pose at any time, and the truth is only passed on.
ORDERED = (Scan, Odometry, YawRate)


class MessageCheck:
    """Check of one message after the other."""

    def __init__(self, after: float = -math.inf) -> None:
        """`after` is the last stamp of the session that is continued, seconds; without one -inf."""
        self._after = after
        self._latest: dict[tuple[type, int], float] = {}  # stamp of the last message, by type and number of the lidar
        self._units = UnitCheck()

    def checked(self, message: Message) -> Message:
        """Return a message whose arrays are its own and of float64, converted from lists or other numbers if necessary.

        Raises MessageError, with one line, if shapes contradict each other, if a number that must be known is not
        finite, if angles are not in radians and increasing, or if the stamp is more than MAX_STEP_BACK seconds earlier
        than that of the last message of the same type or of the session, or if the first stamp of a sensor is more than
        MAX_APART from those of others. Later, the clock of all may be set. Raises it once if ranges are not in metres,
        or stamps not in seconds, as soon as enough messages show it.
        """
        kind = type(message)
        if kind not in NAMES:
            listed = "Scan, Odometry, YawRate, InitialPose or GroundTruth"
            raise MessageError(f"a message must be a {listed} of the package drivers, not of type {kind.__name__}")
        self._check_stamp(message)
        checked = _checked_content(message)
        sensor = _sensor(message)
        self._latest[sensor] = max(self._latest.get(sensor, -math.inf), float(message.stamp))
        if (problem := self._units.add(checked)) is not None:
            raise _error(checked, problem)
        return checked

    def finish(self) -> None:
        """Check a run that ends. Raises MapError if its messages are in wrong units, and this was not stated before."""
        if (problem := self._units.at_end()) is not None:
            raise MapError(problem)

    def _check_stamp(self, message: Message) -> None:
        stamp, name = message.stamp, NAMES[type(message)]
        if not (_is_number(stamp) and abs(stamp) < MAX_STAMP):
            raise MessageError(f"{name}: the stamp must be a number of seconds, not {stamp!r}")
        if not isinstance(message, ORDERED):
            return
        if stamp < self._after - MAX_STEP_BACK:
            end = f"the session that is continued ends at {self._after:.3f} s"
            raise _error(message, f"{end}; add a constant to all stamps, so that they follow")
        latest = self._latest.get(_sensor(message), -math.inf)
        if stamp < latest - MAX_STEP_BACK:
            raise _error(message, f"it follows one at {latest:.3f} s, but messages must be added in time order")
        for (other, _), seconds in self._latest.items() if math.isinf(latest) else ():
            if other in ORDERED and abs(stamp - seconds) > MAX_APART:
                far = f"another {NAMES[other]}" if other is type(message) else NAMES[other]
                raise _error(message, f"{far} is stamped {seconds:.3f} s, so both are not seconds of one clock")


def _sensor(message: Message) -> tuple[type, int]:
    return type(message), message.lidar if isinstance(message, Scan) else 0


def _checked_content(message: Message) -> Message:
    if isinstance(message, Scan):
        return _checked_scan(message)
    if isinstance(message, YawRate):
        if not _is_number(message.rate):
            raise _error(message, f"the rate must be a finite number, radians per second, not {message.rate!r}")
        return message
    return _checked_pose(message)


def _checked_scan(scan: Scan) -> Scan:
    ranges, angles, offsets = (_row(scan, name) for name in ("ranges", "angles", "time_offsets"))
    strengths = None if scan.intensities is None else _row(scan, "intensities")
    if not len(ranges) == len(angles) == len(offsets):
        counts = f"{len(ranges)} ranges, {len(angles)} angles and {len(offsets)} time offsets"
        raise _error(scan, f"{counts}, but each beam has one of each")
    if strengths is not None and len(strengths) != len(ranges):
        raise _error(scan, f"{len(ranges)} ranges, but {len(strengths)} intensities")
    if not np.isfinite(angles).all():
        raise _error(scan, "the angles must be finite; only ranges may be NaN")
    if not np.isfinite(offsets).all():
        raise _error(scan, "the time offsets must be finite; they are zeros if unknown")
    if np.abs(offsets).max(initial=0.0) > MAX_TURN_PERIOD:
        longest = f"up to {np.abs(offsets).max():g} s from the stamp to a beam"
        raise _error(scan, f"{longest}, but no lidar turns as slowly; time offsets must be in seconds")
    if len(angles) > 1:
        _check_order(scan, angles)
    for name in ("range_min", "range_max"):
        if not isinstance(getattr(scan, name), int | float | np.number):
            raise _error(scan, f"{name} must be a number of metres, not {getattr(scan, name)!r}")
    if scan.lidar not in (0, 1):
        raise _error(scan, f"the lidar must be 0, the first, or 1, the second, not {scan.lidar!r}")
    mount = None if scan.mount is None else _row(scan, "mount", 3)
    given = scan.ranges, scan.angles, scan.time_offsets, scan.mount, scan.intensities
    if all(one is other for one, other in zip(given, (ranges, angles, offsets, mount, strengths), strict=True)):
        return scan
    return replace(scan, ranges=ranges, angles=angles, time_offsets=offsets, mount=mount, intensities=strengths)


def _check_order(scan: Scan, angles: Floats) -> None:
    if (angles[1:] < angles[:-1]).any():
        raise _error(scan, "the angles must increase; reverse all arrays of a scan that is measured clockwise")
    span = float(angles[-1] - angles[0])
    if span > MAX_SPAN:
        raise _error(scan, f"the angles span {span:.1f}, which is more than two turns; they must be in radians")


def _checked_pose(message: Odometry | InitialPose | GroundTruth) -> Message:
    pose = _row(message, "pose", 3)
    if not all(abs(number) <= MAX_LENGTH for number in pose.tolist()):  # also NaN
        raise _error(message, f"the pose must be finite, metres and radians, not {pose.tolist()}")
    return message if pose is message.pose else replace(message, pose=pose)


def _row(message: Message, name: str, length: int | None = None) -> Floats:
    """Return an attribute as an array (n,) of float64, the same one if it cannot change. Raises MessageError.

    A program may write the next measurement into the same array, while a scan still waits for odometry.
    """
    value: Any = getattr(message, name)
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.asarray(None)
    if array.size and array.dtype.kind not in NUMBERS:
        raise _error(message, f"{name} must be an array of numbers, not {type(value).__name__}")
    if array.ndim != 1:
        raise _error(message, f"{name} must be one row of numbers, not an array of the shape {array.shape}")
    if length is not None and len(array) != length:
        raise _error(message, f"{name} must be {length} numbers: x, y, heading; there are {len(array)}")
    return array.astype(np.float64, copy=array.flags.writeable)


def _is_number(value: object) -> bool:
    """Return True if a value is a finite number, of Python or NumPy."""
    return isinstance(value, int | float | np.integer | np.floating) and math.isfinite(value)


def _error(message: Message, problem: str) -> MessageError:
    return MessageError(f"{NAMES[type(message)]} at {message.stamp:.3f} s: {problem}")
