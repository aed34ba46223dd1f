"""Check of the messages that the pipeline is given, so that an error of a user's program is named where it is made."""

from __future__ import annotations

import math

import numpy as np

from drivers.message_arrays import NAMES, message_error, stamp_error, with_own_arrays
from drivers.messages import MAX_SPAN, MAX_TURN_PERIOD, Message, Odometry, Scan, YawRate
from drivers.recordings.stamp_units import MAX_STAMP

from ..bounds import MAX_LENGTH
from ..errors import MapError
from ..geometry.segments import Floats
from .unit_check import UnitCheck

# Seconds by which a message may be earlier than the one before of its sensor. Origin: as in recordings, whose messages
# are sorted within a second; more than the jitter of any stamps.
MAX_STEP_BACK = 1.0
# Seconds between the stamps of two sensors above which they are not of one clock, or not both in seconds.
# Origin: chosen, some months; no device is silent for as long in one run.
MAX_APART = 1e7
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
        checked = with_own_arrays(message)
        self._check_stamp(message)
        _check_values(checked)
        sensor = _sensor(message)
        self._latest[sensor] = max(self._latest.get(sensor, -math.inf), float(message.stamp))
        if (problem := self._units.add(checked)) is not None:
            raise message_error(checked, problem)
        return checked

    def finish(self) -> None:
        """Check a run that ends. Raises MapError if its messages are in wrong units, and this was not stated before."""
        if (problem := self._units.at_end()) is not None:
            raise MapError(problem)

    def _check_stamp(self, message: Message) -> None:
        stamp = message.stamp
        if not abs(stamp) < MAX_STAMP:
            raise stamp_error(message)
        if not isinstance(message, ORDERED):
            return
        if stamp < self._after - MAX_STEP_BACK:
            end = f"the session that is continued ends at {self._after:.3f} s"
            raise message_error(message, f"{end}; add a constant to all stamps, so that they follow")
        latest = self._latest.get(_sensor(message), -math.inf)
        if stamp < latest - MAX_STEP_BACK:
            raise message_error(message, f"it follows one at {latest:.3f} s, but messages must be added in time order")
        for (other, _), seconds in self._latest.items() if math.isinf(latest) else ():
            if other in ORDERED and abs(stamp - seconds) > MAX_APART:
                far = f"another {NAMES[other]}" if other is type(message) else NAMES[other]
                raise message_error(message, f"{far} is stamped {seconds:.3f} s, so both are not seconds of one clock")


def _sensor(message: Message) -> tuple[type, int]:
    return type(message), message.lidar if isinstance(message, Scan) else 0


def _check_values(message: Message) -> None:
    if isinstance(message, Scan):
        _check_beams(message)
    elif isinstance(message, YawRate):
        if not math.isfinite(message.rate):
            raise message_error(message, f"the rate must be a finite number, radians per second, not {message.rate!r}")
    elif not all(abs(number) <= MAX_LENGTH for number in message.pose.tolist()):  # also NaN
        raise message_error(message, f"the pose must be finite, metres and radians, not {message.pose.tolist()}")


def _check_beams(scan: Scan) -> None:
    angles, offsets = scan.angles, scan.time_offsets
    if not np.isfinite(angles).all():
        raise message_error(scan, "the angles must be finite; only ranges may be NaN")
    if not np.isfinite(offsets).all():
        raise message_error(scan, "the time offsets must be finite; they are zeros if unknown")
    if np.abs(offsets).max(initial=0.0) > MAX_TURN_PERIOD:
        longest = f"up to {np.abs(offsets).max():g} s from the stamp to a beam"
        raise message_error(scan, f"{longest}, but no lidar turns as slowly; time offsets must be in seconds")
    if len(angles) > 1:
        _check_order(scan, angles)


def _check_order(scan: Scan, angles: Floats) -> None:
    if (angles[1:] < angles[:-1]).any():
        raise message_error(scan, "the angles must increase; reverse all arrays of a scan that is measured clockwise")
    span = float(angles[-1] - angles[0])
    if span > MAX_SPAN:
        raise message_error(scan, f"the angles span {span:.1f}, which is more than two turns; they must be in radians")
