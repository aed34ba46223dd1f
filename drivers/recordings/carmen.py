"""Reader for CARMEN logs: text with one message per line, plain or compressed with gzip.

    ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp
    FLASER n r1 .. rn laser_x laser_y laser_theta robot_x robot_y robot_theta
        ipc_timestamp host logger_timestamp
    RLASER (rear laser; fields as FLASER)
    ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode
        n r1 .. rn m e1 .. em
        laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis
        ipc_timestamp host logger_timestamp

Metres and radians; other lines (PARAM, SYNC, comments, ...) are ignored. The stamp is the ipc_timestamp, the time of the
measurement; the logger_timestamp is the time at which the line was written. Lines are in the order in which they reached
the logger: those of one sensor are in true order, those of different sensors need not be.
"""

from __future__ import annotations

import gzip
import math
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
from .microseconds import restore_microseconds
from .no_returns import find_no_return
from .reader import RecordingReader

LASERS = (b"FLASER", b"RLASER", b"ROBOTLASER1")
KINDS = (b"ODOM", *LASERS)

SICK_NO_RETURN = 81.83
"""Metres. A SICK LMS in centimetre mode reports codes 8183 to 8191 instead of a range: no echo, dazzled, etc."""
CALIBRATION_LINES = 200
"""Laser lines, spread over the log, from which each laser's mount and no-return value are determined."""
MAX_MOUNT_SCATTER = (0.05, 0.05)
"""Metres and radians. If laser relative to robot poses scatter by more, the laser is not rigidly mounted."""

_DECIMAL = re.compile(rb"\d+(\.\d+)?$")
_TEXT = re.compile(rb"#|[A-Za-z\"][\x20-\x7e\t]*$")


@dataclass(slots=True)
class LaserProperties:
    """Constant properties of one laser of the log."""

    mount: se2.Pose | None
    no_return: float  # metres; readings from this value on are no-returns


@dataclass(slots=True)
class LaserLine:
    """Parsed laser line. `limit` is the maximum range stated in the line, None if there is none."""

    stamp: float
    readings: Floats
    angles: Floats
    poses: Floats  # laser x y theta, robot x y theta
    limit: float | None


@dataclass(slots=True)
class _OdometryFilter:
    """Filter for odometry that is repeated: laser lines contain the robot's odometry too."""

    last: tuple[float, ...] = ()
    from_scan: bool = False
    has_odometry: bool = False

    def is_new(self, values: tuple[float, ...], from_scan: bool) -> bool:
        """Return true if the odometry (stamp, x, y, theta) of a laser line or an ODOM line is not a repetition."""
        if from_scan and not self.has_odometry and values[1:] == (0.0, 0.0, 0.0):
            return False  # logs of a laser without a robot contain only zeros
        repeated = values == self.last and (from_scan or self.from_scan)
        self.last, self.from_scan, self.has_odometry = values, from_scan, True
        return not repeated


class CarmenReader(RecordingReader):
    """CARMEN log as a `Source`. Bad lines are skipped and counted; a log without a valid line raises RecordingError.

    A laser line contains the odometry at its stamp too: an Odometry is yielded before its Scan, unless the preceding
    ODOM line is equal.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        self._length: int | None = None

    def __len__(self) -> int:
        """Return the number of lines with odometry or a scan."""
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
        odometry = _OdometryFilter()
        stamps = self._restored_stamps(lines)
        for number, line in enumerate(lines, start=1):
            kind = line[:12].partition(b" ")[0]
            try:
                if kind == b"ODOM":
                    values = _odometry(line)
                    if number in stamps:
                        values = (stamps[number], *values[1:])
                    if odometry.is_new(values, from_scan=False):
                        yield number, Odometry(values[0], np.array(values[1:]))
                elif kind in lasers:
                    parsed = _laser(kind, line)
                    parsed.stamp = stamps.get(number, parsed.stamp)
                    values = (parsed.stamp, *parsed.poses[3:].tolist())
                    if odometry.is_new(values, from_scan=True):
                        yield number, Odometry(parsed.stamp, parsed.poses[3:].copy())
                    yield number, _scan(parsed, lasers[kind])
                elif line and not _TEXT.match(line.strip()):
                    raise ValueError("line is not text")
            except ValueError as error:
                self.skip(number, _reason(kind, error))
        if damage:
            self.skip(len(lines), damage)

    def _restored_stamps(self, lines: list[bytes]) -> dict[int, float]:
        """Return line number -> stamp for all stamps that have to be read differently from what is written."""
        restored = restore_microseconds(written for _, written in _written_stamps(lines))
        if restored is None:
            return {}
        changed = {
            number: stamp
            for (number, written), stamp in zip(_written_stamps(lines), restored, strict=True)
            if stamp != float(written)
        }
        self.interpret(
            f"microseconds are written without leading zeros; {len(changed)} stamps are restored from the order of lines"
        )
        return changed

    def _empty_reason(self) -> str:
        return "is not a CARMEN log: it has no readable ODOM, FLASER, RLASER or ROBOTLASER1 line"


def _content(path: Path) -> tuple[bytes, str | None]:
    """Return the log's bytes up to a damaged place, and the damage of its compression, None if there is none."""
    with path.open("rb") as uncompressed:
        if uncompressed.read(2) != b"\x1f\x8b":
            uncompressed.seek(0)
            return uncompressed.read(), None
    pieces: list[bytes] = []
    with gzip.open(path) as file:
        try:
            while piece := file.read(1 << 16):
                pieces.append(piece)
        except (EOFError, gzip.BadGzipFile, zlib.error):
            return b"".join(pieces), "gzip stream is damaged or truncated"
    return b"".join(pieces), None


def _reason(kind: bytes, error: ValueError) -> str:
    """Return a reason without the line's own numbers, so that equal errors are counted together."""
    text = str(error)
    is_number_error = text.startswith(("could not convert", "invalid literal"))
    reason = "field is not a number" if is_number_error else text
    return f"{kind.decode()} line: {reason}" if kind in KINDS else f"line: {reason}"


def _odometry(line: bytes) -> tuple[float, float, float, float]:
    """Return stamp, x, y, theta of an ODOM line."""
    words = line.split()
    if len(words) < 9:  # if the host after it is missing, the stamp may be truncated
        raise ValueError("too few fields")
    x, y, theta, stamp = float(words[1]), float(words[2]), float(words[3]), float(words[7])
    _check(stamp, x, y, theta)
    return stamp, x, y, theta


def _laser(kind: bytes, line: bytes) -> LaserLine:
    """Parse a laser line; raises ValueError if it is incomplete or invalid."""
    words = line.split()
    if kind == b"ROBOTLASER1":
        return _robotlaser(words)
    count = _count(words, 1)
    readings, rest = words[2 : 2 + count], words[2 + count :]
    if not 8 <= len(rest) <= 9:
        raise ValueError("number of fields does not match the number of beams")
    poses, stamp = np.array([float(word) for word in rest[:6]]), float(rest[6])
    _check(stamp, *poses)
    return LaserLine(stamp, np.array([float(word) for word in readings]), half_turn_angles(count), poses, None)


def _robotlaser(words: list[bytes]) -> LaserLine:
    count = _count(words, 8)
    if count == 0 or len(words) < 10 + count:
        raise ValueError("number of fields does not match the number of beams")
    remissions = int(words[9 + count])
    rest = words[10 + count + remissions :]
    if remissions < 0 or not 13 <= len(rest) <= 14:
        raise ValueError("number of fields does not match the number of beams")
    start, resolution, limit = float(words[2]), float(words[4]), float(words[5])
    if not (abs(start) < 10.0 and 0.0 < resolution < 7.0 and limit > 0.0):
        raise ValueError("start angle, resolution or maximum range is invalid")
    poses, stamp = np.array([float(word) for word in rest[:6]]), float(rest[11])
    _check(stamp, *poses)
    readings = np.array([float(word) for word in words[9 : 9 + count]])
    angles = start + resolution * np.arange(count, dtype=np.float64)
    return LaserLine(stamp, readings, angles, poses, limit)


def _written_stamps(lines: list[bytes]) -> Iterator[tuple[int, bytes]]:
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


def _check(stamp: float, *pose: float) -> None:
    if not 0.0 <= stamp < math.inf:
        raise ValueError("stamp is invalid")
    if not np.all(np.abs(pose) < 1e9):
        raise ValueError("pose is not finite")


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


def _scan(line: LaserLine, laser: LaserProperties) -> Scan:
    limit = min(_stated_limit(line), laser.no_return)
    valid = (line.readings > 0.0) & (line.readings < limit)  # false for nan
    ranges = np.where(valid, line.readings, np.nan)
    return Scan(line.stamp, ranges, line.angles, np.zeros(len(ranges)), 0.0, limit, laser.mount)


def _calibrate(kind: bytes, lines: list[bytes]) -> LaserProperties:
    """Determine a laser's mount and no-return value from lines spread over the log."""
    start = kind + b" "
    of_kind = [line for line in lines if line.startswith(start)]
    parsed: list[LaserLine] = []
    for line in of_kind[:: max(1, len(of_kind) // CALIBRATION_LINES)]:
        try:
            parsed.append(_laser(kind, line))
        except ValueError:
            continue  # counted when the line is read
    if not parsed:
        return LaserProperties(None, math.inf)
    poses = np.array([line.poses for line in parsed])
    readings = [np.where(line.readings < _stated_limit(line), line.readings, np.nan) for line in parsed]
    no_return = find_no_return(readings)
    return LaserProperties(_estimate_mount(poses), math.inf if no_return is None else no_return)


def _stated_limit(line: LaserLine) -> float:
    """Return the maximum range (metres) that a laser line states; lines without one are of SICK lasers."""
    return SICK_NO_RETURN if line.limit is None else line.limit


def _estimate_mount(poses: Floats) -> se2.Pose | None:
    """Return the laser's pose on the robot from (m, 6) laser and robot poses; None if they are not rigidly connected.

    A single difference contains the rounding of world coordinates, and on a moving robot the two poses may be of
    slightly different times; the median over the log averages both out. It is rounded to the log's precision of 0.1 mm
    and 0.1 mrad.
    """
    mounts = se2.between(poses[:, 3:], poses[:, :3])
    heading = mounts[0, 2] + se2.wrap(mounts[:, 2] - mounts[0, 2])
    mounts = np.column_stack([mounts[:, :2], heading])
    median = np.median(mounts, axis=0)
    scatter = np.median(np.abs(mounts - median), axis=0)
    if max(scatter[:2]) > MAX_MOUNT_SCATTER[0] or scatter[2] > MAX_MOUNT_SCATTER[1]:
        return None
    mount = np.round(median, 4) + 0.0  # + 0.0 turns -0.0 into 0.0
    mount[2] = -np.pi if abs(abs(mount[2]) - np.pi) < 1e-4 else float(se2.wrap(mount[2]))
    mount.flags.writeable = False
    return mount
