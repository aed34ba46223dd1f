"""Arrays of messages that programs make, converted from lists and other numbers, or refused in one line."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .errors import MessageError
from .messages import Floats, GroundTruth, InitialPose, Message, Odometry, Scan, YawRate

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


def with_own_arrays(message: Message) -> Message:
    """Return a message whose arrays are its own and of float64, converted from lists or other numbers if necessary.

    Raises MessageError, with one line, if it is no message, or if its stamp, its numbers or its arrays have a wrong
    type, or shapes that contradict each other. Values are not checked, and may not be finite.
    """
    kind = type(message)
    if kind not in NAMES:
        listed = "Scan, Odometry, YawRate, InitialPose or GroundTruth"
        raise MessageError(f"a message must be a {listed} of the package drivers, not of type {kind.__name__}")
    if not _is_number(message.stamp):
        raise stamp_error(message)
    if isinstance(message, Scan):
        return _scan_with_own_arrays(message)
    if isinstance(message, YawRate):
        if not _is_number(message.rate):
            raise message_error(message, f"the rate must be a number, radians per second, not {message.rate!r}")
        return message
    pose = _row(message, "pose", 3)
    return message if pose is message.pose else replace(message, pose=pose)


def _scan_with_own_arrays(scan: Scan) -> Scan:
    ranges, angles, offsets = (_row(scan, name) for name in ("ranges", "angles", "time_offsets"))
    strengths = None if scan.intensities is None else _row(scan, "intensities")
    if not len(ranges) == len(angles) == len(offsets):
        counts = f"{len(ranges)} ranges, {len(angles)} angles and {len(offsets)} time offsets"
        raise message_error(scan, f"{counts}, but each beam has one of each")
    if strengths is not None and len(strengths) != len(ranges):
        raise message_error(scan, f"{len(ranges)} ranges, but {len(strengths)} intensities")
    for name in ("range_min", "range_max"):
        if not _is_number(getattr(scan, name)):
            raise message_error(scan, f"{name} must be a number of metres, not {getattr(scan, name)!r}")
    if scan.lidar not in (0, 1):
        raise message_error(scan, f"the lidar must be 0, the first, or 1, the second, not {scan.lidar!r}")
    mount = None if scan.mount is None else _row(scan, "mount", 3)
    given = scan.ranges, scan.angles, scan.time_offsets, scan.mount, scan.intensities
    if all(one is other for one, other in zip(given, (ranges, angles, offsets, mount, strengths), strict=True)):
        return scan
    return replace(scan, ranges=ranges, angles=angles, time_offsets=offsets, mount=mount, intensities=strengths)


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
        raise message_error(message, f"{name} must be an array of numbers, not {type(value).__name__}")
    if array.ndim != 1:
        raise message_error(message, f"{name} must be one row of numbers, not an array of the shape {array.shape}")
    if length is not None and len(array) != length:
        raise message_error(message, f"{name} must be {length} numbers: x, y, heading; there are {len(array)}")
    return array.astype(np.float64, copy=array.flags.writeable)


def _is_number(value: object) -> bool:
    """Return True if a value is a number, of Python or NumPy."""
    return isinstance(value, int | float | np.integer | np.floating)


def stamp_error(message: Message) -> MessageError:
    """Return the error of a message whose stamp is no time."""
    return MessageError(f"{NAMES[type(message)]}: the stamp must be a number of seconds, not {message.stamp!r}")


def message_error(message: Message, problem: str) -> MessageError:
    """Return the error of a message with a problem, named by its kind and its stamp."""
    return MessageError(f"{NAMES[type(message)]} at {message.stamp:.3f} s: {problem}")
