"""Lines of CARMEN logs.

    ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
    FLASER n r1 .. rn laser_x laser_y laser_theta robot_x robot_y robot_theta
        ipc_timestamp host logger_timestamp
    RLASER (rear laser; fields as FLASER)
    ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode
        n r1 .. rn m e1 .. em
        laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis
        ipc_timestamp host logger_timestamp

Metres, radians and seconds. The stamp is the ipc_timestamp, the time of the measurement; the logger_timestamp is when
the line was written, counted from the start of the log. Lines are in the order in which they reached the logger:
those of one sensor are in true order, those of different sensors need not be.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..messages import MAX_SPAN, Floats

LASERS = (b"FLASER", b"RLASER", b"ROBOTLASER1")
KINDS = (b"ODOM", *LASERS)

SICK_NO_RETURN = 81.83
"""Metres. A SICK LMS in centimetre mode reports codes 8183 to 8191 instead of a range: no echo, dazzled, etc."""

MAX_NUMBERS = 1 << 16
"""Different readings that are kept. Origin: chosen; some megabytes, and ranges in millimetres up to 65 m."""

_DECIMAL = re.compile(rb"\d+(\.\d+)?$")


@dataclass(slots=True)
class LaserLine:
    """Parsed laser line. `limit` is the maximum range stated in the line, None if there is none."""

    stamp: float
    readings: Floats
    angles: Floats
    poses: Floats  # laser x y theta, robot x y theta
    limit: float | None


class _Numbers(dict[bytes, float]):
    """Numbers by their text. A log has few different readings, and to look one up is faster than to convert it."""

    def __missing__(self, text: bytes) -> float:
        if len(self) >= MAX_NUMBERS:
            self.clear()
        number = self[text] = float(text)
        return number


_NUMBERS = _Numbers()


def _numbers(words: list[bytes]) -> Floats:
    """Return the readings (n,) of a laser line."""
    return np.fromiter(map(_NUMBERS.__getitem__, words), np.float64, len(words))


def parse_odometry(line: bytes) -> tuple[float, Floats]:
    """Return the stamp, which is not checked, and the pose (3,) of an ODOM line."""
    words = line.split()
    if len(words) < 9:  # if the host after it is missing, the stamp may be truncated
        raise ValueError("too few fields")
    x, y, theta, stamp = float(words[1]), float(words[2]), float(words[3]), float(words[7])
    _check(x, y, theta)
    return stamp, np.array([x, y, theta])


def parse_laser(kind: bytes, line: bytes) -> LaserLine:
    """Parse a laser line; raises ValueError if it is incomplete or invalid. Its stamp is not checked."""
    words = line.split()
    if kind == b"ROBOTLASER1":
        return _robotlaser(words)
    count = _count(words, 1)
    readings, rest = words[2 : 2 + count], words[2 + count :]
    if not 8 <= len(rest) <= 9:
        raise ValueError("number of fields does not match the number of beams")
    poses, stamp = [float(word) for word in rest[:6]], float(rest[6])
    _check(*poses)
    return LaserLine(stamp, _numbers(readings), half_turn_angles(count), np.array(poses), None)


def _robotlaser(words: list[bytes]) -> LaserLine:
    count = _count(words, 8)
    if count == 0 or len(words) < 10 + count:
        raise ValueError("number of fields does not match the number of beams")
    remissions = int(words[9 + count])
    rest = words[10 + count + remissions :]
    if remissions < 0 or not 13 <= len(rest) <= 14:
        raise ValueError("number of fields does not match the number of beams")
    start, resolution, limit = float(words[2]), float(words[4]), float(words[5])
    if not (abs(start) < 10.0 and 0.0 < resolution < 7.0 and resolution * count <= MAX_SPAN and limit > 0.0):
        raise ValueError("start angle, resolution or maximum range is invalid")
    poses, stamp = [float(word) for word in rest[:6]], float(rest[11])
    _check(*poses)
    return LaserLine(stamp, _numbers(words[9 : 9 + count]), _angles(start, resolution, count), np.array(poses), limit)


def written_stamps(lines: Iterable[bytes]) -> Iterator[tuple[int, bytes]]:
    """Yield the number of each line with a measurement, and its stamp as written, without parsing the measurement."""
    for number, line in enumerate(lines, start=1):
        kind = line[:12].partition(b" ")[0]
        if kind == b"ODOM":
            words = line.split(None, 8)
            if len(words) == 9:
                yield number, words[7]
        elif kind in LASERS:
            last = line.rsplit(None, 3)[1:]  # stamp, host, logger's stamp; some logs omit the last
            if len(last) == 3:
                yield number, last[0] if _DECIMAL.match(last[2]) and not _DECIMAL.match(last[1]) else last[1]


def _count(words: list[bytes], index: int) -> int:
    count = int(words[index]) if len(words) > index else 0
    if count < 1:
        raise ValueError("no beams")
    return count


def check_stamp(stamp: float) -> float:
    """Return the stamp of a line, seconds; raises ValueError if it is negative or not finite."""
    if not 0.0 <= stamp < math.inf:
        raise ValueError("stamp is invalid")
    return stamp


def _check(*pose: float) -> None:
    for value in pose:
        if not abs(value) < 1e9:  # also nan
            raise ValueError("pose is not finite")


@lru_cache(maxsize=64)
def _angles(start: float, resolution: float, count: int) -> Floats:
    """Return the angles (count,) of a laser that states the first one and their distance, radians, read-only."""
    angles = start + resolution * np.arange(count, dtype=np.float64)
    angles.flags.writeable = False
    return angles


@lru_cache(maxsize=64)
def no_offsets(count: int) -> Floats:
    """Return zeros (count,) as the times of the beams, which no line states; read-only."""
    offsets = np.zeros(count)
    offsets.flags.writeable = False
    return offsets


@lru_cache(maxsize=64)
def half_turn_angles(count: int) -> Floats:
    """Return the angles (count,) of a laser with a field of view of 180 degrees, radians, read-only.

    FLASER lines do not state them. An odd count includes both ends (361: -90 to 90 degrees in steps of half a degree),
    an even one omits the last (180: -90 to 89).
    """
    steps = count - 1 if count % 2 and count > 1 else count
    angles = -np.pi / 2 + np.pi / steps * np.arange(count, dtype=np.float64)
    angles.flags.writeable = False
    return angles
