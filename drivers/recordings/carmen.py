"""CARMEN logs: text, one message a line, plain or compressed with gzip.

    ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
    FLASER n r1 .. rn laser_x laser_y laser_theta robot_x robot_y robot_theta
        ipc_timestamp host logger_timestamp
    RLASER (a second laser that looks back; as FLASER)
    ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode
        n r1 .. rn m e1 .. em
        laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis
        ipc_timestamp host logger_timestamp

Metres and radians; other kinds of lines (PARAM, SYNC, comments, ...) are passed over. The stamp is the
ipc_timestamp.
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from .. import se2
from ..errors import RecordingError
from ..messages import Floats, Message, Odometry, Scan
from .reader import Recording, is_stamp

LASERS = (b"FLASER", b"RLASER", b"ROBOTLASER1")
KINDS = (b"ODOM", *LASERS)

SICK_NO_RETURN = 81.83
"""Metres. A SICK LMS in centimetre mode says 8183 to 8191 instead of a range: no echo, dazzled, and the like."""
SICK_NO_RETURN_MM = 8.183
"""The same codes in millimetre mode."""
SAMPLES = 200
"""Laser lines, spread over the log, from which each laser's mount and no-return value are learnt."""
RIGID = (0.05, 0.05)
"""Metres and radians: laser and robot poses that scatter by more are not those of a laser bolted to the robot."""

_TEXT = re.compile(rb"#|[A-Za-z\"][\x20-\x7e\t]*$")


@dataclass(slots=True)
class Laser:
    """What is constant about one laser of the log."""

    mount: se2.Pose | None
    no_return: float  # metres; a reading from here on means that nothing came back


@dataclass(slots=True)
class LaserLine:
    """One laser line, parsed. `limit` is the maximum range that the line states, None if it states none."""

    stamp: float
    readings: Floats
    angles: Floats
    poses: Floats  # laser x y theta, robot x y theta
    limit: float | None


@dataclass(slots=True)
class _OdometrySoFar:
    """Laser lines repeat the robot's odometry; this says which repetitions are news."""

    last: tuple[float, ...] = ()
    from_scan: bool = False
    any: bool = False

    def is_news(self, values: tuple[float, ...], from_scan: bool) -> bool:
        """Whether to yield the odometry (stamp, x, y, theta), which a laser line told or an ODOM line."""
        if from_scan and not self.any and values[1:] == (0.0, 0.0, 0.0):
            return False  # logs of a laser without a robot say zero for ever
        repeated = values == self.last and (from_scan or self.from_scan)
        self.last, self.from_scan, self.any = values, from_scan, True
        return not repeated


class Carmen(Recording):
    """A CARMEN log as a `Source`. Bad lines are skipped and counted; a log without one good line raises
    RecordingError.

    A laser line tells the odometry at its stamp as well: it yields an Odometry just before its Scan, unless
    an ODOM line just said the same.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        self._length: int | None = None

    def __len__(self) -> int:
        """The number of lines that hold odometry or a scan."""
        if self._length is None:
            try:
                content = b"\n" + _content(self.path)[0]
            except OSError:
                return 0
            self._length = sum(content.count(b"\n" + kind + b" ") for kind in KINDS)
        return self._length

    def _read(self) -> Iterator[tuple[int, Message]]:
        content, damage = _content(self.path)
        if not content.strip():
            raise RecordingError(self.path, None, damage or "is empty")
        lines = content.split(b"\n")
        lasers = {kind: _calibrate(kind, lines) for kind in LASERS}
        odometry = _OdometrySoFar()
        for number, line in enumerate(lines, start=1):
            kind = line[:12].partition(b" ")[0]
            try:
                if kind == b"ODOM":
                    values = _odometry(line)
                    if odometry.is_news(values, from_scan=False):
                        yield number, Odometry(values[0], np.array(values[1:]))
                elif kind in lasers:
                    parsed = _laser(kind, line)
                    values = (parsed.stamp, *parsed.poses[3:].tolist())
                    if odometry.is_news(values, from_scan=True):
                        yield number, Odometry(parsed.stamp, parsed.poses[3:].copy())
                    yield number, _scan(parsed, lasers[kind])
                elif line and not _TEXT.match(line.strip()):
                    raise ValueError("line is not text")
            except ValueError as error:
                self.skip(number, _reason(kind, error))
        if damage:
            self.skip(len(lines), damage)

    def _nothing_found(self) -> str:
        return "is not a CARMEN log: it has no readable ODOM, FLASER, RLASER or ROBOTLASER1 line"


def _content(path: Path) -> tuple[bytes, str | None]:
    """The log's bytes, and what is wrong with its compression; what precedes a damaged place is kept."""
    with path.open("rb") as plain:
        if plain.read(2) != b"\x1f\x8b":
            plain.seek(0)
            return plain.read(), None
    pieces: list[bytes] = []
    with gzip.open(path) as file:
        try:
            while piece := file.read(1 << 16):
                pieces.append(piece)
        except (EOFError, gzip.BadGzipFile, zlib.error):
            return b"".join(pieces), "gzip stream is damaged or ends early"
    return b"".join(pieces), None


def _reason(kind: bytes, error: ValueError) -> str:
    """A reason without the line's own numbers, so that equal mistakes are counted together."""
    text = str(error)
    known = text if not text.startswith(("could not convert", "invalid literal")) else "not a number where one belongs"
    return f"{kind.decode()} line: {known}" if kind in KINDS else f"line: {known}"


def _odometry(line: bytes) -> tuple[float, float, float, float]:
    """Stamp, x, y, theta of an ODOM line."""
    words = line.split()
    if len(words) < 9:  # without the host after it the stamp itself may be cut off
        raise ValueError("too few fields")
    x, y, theta, stamp = float(words[1]), float(words[2]), float(words[3]), float(words[7])
    _check(stamp, x, y, theta)
    return stamp, x, y, theta


def _laser(kind: bytes, line: bytes) -> LaserLine:
    """A laser line's fields; raises ValueError where it is not a whole one."""
    words = line.split()
    if kind == b"ROBOTLASER1":
        return _robotlaser(words)
    count = _count(words, 1)
    readings, rest = words[2 : 2 + count], words[2 + count :]
    if not 8 <= len(rest) <= 9:
        raise ValueError("number of fields does not fit the number of beams")
    poses, stamp = np.array([float(word) for word in rest[:6]]), float(rest[6])
    _check(stamp, *poses)
    return LaserLine(stamp, np.array([float(word) for word in readings]), half_turn(count), poses, None)


def _robotlaser(words: list[bytes]) -> LaserLine:
    count = _count(words, 8)
    if count == 0 or len(words) < 10 + count:
        raise ValueError("number of fields does not fit the number of beams")
    remissions = int(words[9 + count])
    rest = words[10 + count + remissions :]
    if remissions < 0 or not 13 <= len(rest) <= 14:
        raise ValueError("number of fields does not fit the number of beams")
    start, resolution, limit = float(words[2]), float(words[4]), float(words[5])
    if not (abs(start) < 10.0 and 0.0 < resolution < 7.0 and limit > 0.0):
        raise ValueError("start angle, resolution or maximum range is impossible")
    poses, stamp = np.array([float(word) for word in rest[:6]]), float(rest[11])
    _check(stamp, *poses)
    readings = np.array([float(word) for word in words[9 : 9 + count]])
    angles = start + resolution * np.arange(count, dtype=np.float64)
    return LaserLine(stamp, readings, angles, poses, limit)


def _count(words: list[bytes], index: int) -> int:
    count = int(words[index]) if len(words) > index else 0
    if count < 1:
        raise ValueError("no beams")
    return count


def _check(stamp: float, *pose: float) -> None:
    if not is_stamp(stamp):
        raise ValueError("stamp is impossible")
    if not np.all(np.abs(pose) < 1e9):
        raise ValueError("pose is not finite")


@lru_cache(maxsize=64)
def half_turn(count: int) -> Floats:
    """Angles (count,) of a laser that sees half a turn and does not state them, radians, read-only.

    An odd count has a beam at either end (361: -90 to 90 degrees in steps of half a degree), an even one
    leaves out the last (180: -90 to 89).
    """
    steps = count - 1 if count % 2 and count > 1 else count
    angles = -np.pi / 2 + np.pi / steps * np.arange(count, dtype=np.float64)
    angles.flags.writeable = False
    return angles


def _scan(line: LaserLine, laser: Laser) -> Scan:
    limit = laser.no_return if line.limit is None else line.limit
    valid = (line.readings > 0.0) & (line.readings < limit)  # false for nan
    ranges = np.where(valid, line.readings, np.nan)
    return Scan(line.stamp, ranges, line.angles, np.zeros(len(ranges)), 0.0, limit, laser.mount)


def _calibrate(kind: bytes, lines: list[bytes]) -> Laser:
    """A laser's mount and no-return value, from lines spread over the log."""
    start = kind + b" "
    of_kind = [line for line in lines if line.startswith(start)]
    parsed: list[LaserLine] = []
    for line in of_kind[:: max(1, len(of_kind) // SAMPLES)]:
        try:
            parsed.append(_laser(kind, line))
        except ValueError:
            continue  # it is counted when it is read
    if not parsed:
        return Laser(None, SICK_NO_RETURN)
    return Laser(_mount(np.array([line.poses for line in parsed])), _no_return([line.readings for line in parsed]))


def _mount(poses: Floats) -> se2.Pose | None:
    """The laser's pose on the robot from (m, 6) pairs of world poses, None where they are not rigidly
    connected.

    Each difference carries the rounding of world coordinates, and on a moving robot the two may stem from
    slightly different instants; the median over the log does not. It is rounded to the 0.1 mm and 0.1 mrad
    that the log can support.
    """
    mounts = se2.between(poses[:, 3:], poses[:, :3])
    heading = mounts[0, 2] + se2.wrap(mounts[:, 2] - mounts[0, 2])
    mounts = np.column_stack([mounts[:, :2], heading])
    median = np.median(mounts, axis=0)
    scatter = np.median(np.abs(mounts - median), axis=0)
    if max(scatter[:2]) > RIGID[0] or scatter[2] > RIGID[1]:
        return None
    mount = np.round(median, 4) + 0.0  # + 0.0 turns -0.0 into 0.0
    mount[2] = -np.pi if abs(abs(mount[2]) - np.pi) < 1e-4 else float(se2.wrap(mount[2]))
    mount.flags.writeable = False
    return mount


def _no_return(readings: list[Floats]) -> float:
    """The reading (metres) from which on nothing came back.

    The SICK codes are known. Other lasers, and preprocessed logs, repeat some largest value exactly where
    nothing came back: a value that is the largest of the log and stands in a tenth of the scans, twice or
    more in a row, is taken as that. Where this is wrong only the very longest readings are lost.
    """
    largest = max((float(np.max(r[np.isfinite(r)], initial=0.0)) for r in readings), default=0.0)
    if largest >= SICK_NO_RETURN or largest <= 0.0:
        return SICK_NO_RETURN
    repeated = sum(bool(np.any((r[1:] == largest) & (r[:-1] == largest))) for r in readings)
    if repeated < max(3, 0.1 * len(readings)):
        return SICK_NO_RETURN
    return SICK_NO_RETURN_MM if SICK_NO_RETURN_MM <= largest <= 8.191 else largest
