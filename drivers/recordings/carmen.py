"""Reader for CARMEN logs: text with one message per line, plain or compressed with gzip.

Lines other than those in `carmen_lines` (PARAM, SYNC, comments, ...) are ignored.
"""

from __future__ import annotations

import bz2
import codecs
import gzip
import math
import re
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import se2
from ..errors import RecordingError
from ..messages import Floats, Message, Odometry, Scan
from .carmen_lines import (
    KINDS,
    LASERS,
    SICK_NO_RETURN,
    LaserLine,
    check_stamp,
    no_offsets,
    parse_laser,
    parse_odometry,
    written_stamps,
)
from .decompression import MAX_RATIO, allowed_size
from .gmapping_logs import WheelOdometry, remove_estimates
from .microseconds import restore_microseconds
from .no_returns import find_no_return
from .range_units import FAR, ScanInUnits, find_range_unit
from .reader import RecordingReader
from .standing_clock import SPEED, PathClock, clock_stands

CALIBRATION_LINES = 200
"""Laser lines, spread over the log, from which each laser's mount, unit and no-return value are determined."""
MAX_MOUNT_SCATTER = (0.05, 0.05)
"""Metres and radians. If laser relative to robot poses scatter by more, the laser is not rigidly mounted."""

_TEXT = re.compile(rb"#|[A-Za-z\"][\x20-\x7e\t]*$")


@dataclass(slots=True)
class LaserProperties:
    """Constant properties of one laser of the log."""

    mount: se2.Pose | None
    no_return: float  # metres; readings from this value on are no-returns
    per_metre: float  # units of the log's readings in a metre
    has_odometry: bool  # false if the log has only zeros as the robot's pose, as that of a laser without a robot


@dataclass(slots=True)
class _Stamps:
    """Stamps of the lines: as written; `restored` by line number; or by a clock of its own if the log's one stands."""

    restored: dict[int, float]
    clock: PathClock | None = None

    def check(self, written: float) -> None:
        """Raise ValueError for a stamp that is invalid, unless the written ones do not count."""
        if self.clock is None:
            check_stamp(written)

    def of(self, number: int, kind: bytes, written: float, pose: Floats) -> float:
        """Return the stamp of a line of a kind, seconds; `pose` (3,) is the odometry there."""
        if self.clock is not None:
            return self.clock.stamp(kind, pose)
        return self.restored.get(number, written)


@dataclass(slots=True)
class _OdometryFilter:
    """Filter for odometry that is repeated: laser lines contain the robot's odometry too."""

    has_odometry: bool  # true once a pose is known to be measured: until then, zeros may stand for none
    last: tuple[float, ...] = ()
    from_scan: bool = False

    def is_new(self, values: tuple[float, ...], from_scan: bool) -> bool:
        """Return true if the odometry (stamp, x, y, theta) of a laser line or an ODOM line is not a repetition."""
        if from_scan and not self.has_odometry and values[1:] == (0.0, 0.0, 0.0):
            return False
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
                content = _content(self.path)[0]
            except (OSError, RecordingError):  # raised again when it is read
                return 0
            starts = [kind + b" " for kind in KINDS]
            self._length = content.startswith(tuple(starts)) + sum(content.count(b"\n" + start) for start in starts)
        return self._length

    def _read(self) -> Iterator[tuple[int, Message]]:
        content, damage = _content(self.path)
        if not content.strip():
            raise RecordingError(self.path, None, damage or "is empty")
        lines = content.removeprefix(codecs.BOM_UTF8).split(b"\n")
        del content  # the lines are kept while they are read
        wheels, corrected = WheelOdometry(), remove_estimates(lines)
        if corrected:
            self.interpret("written by GMapping, with its estimates in the odometry; the wheels' odometry is restored")
        lasers = {kind: self._calibrate(kind, lines) for kind in LASERS}
        odometry = _OdometryFilter(has_odometry=any(laser.has_odometry for laser in lasers.values()))
        stamps = self._stamps(lines)
        for number, line in enumerate(lines, start=1):
            kind = line[:12].partition(b" ")[0]
            try:
                if kind == b"ODOM":
                    written, pose = parse_odometry(line)
                    stamps.check(written)
                    if corrected:
                        pose = wheels.restore(pose)
                    stamp = stamps.of(number, kind, written, pose)
                    if odometry.is_new((stamp, *pose.tolist()), from_scan=False):
                        yield number, Odometry(stamp, pose)
                elif kind in lasers:
                    parsed = _in_metres(parse_laser(kind, line), lasers[kind].per_metre)
                    stamps.check(parsed.stamp)
                    if corrected and kind == b"FLASER":
                        parsed.poses[3:] = wheels.go_on_from(parsed.poses[3:].copy())
                    parsed.stamp = stamps.of(number, kind, parsed.stamp, parsed.poses[3:])
                    values = (parsed.stamp, *parsed.poses[3:].tolist())
                    if odometry.is_new(values, from_scan=True):
                        yield number, Odometry(parsed.stamp, parsed.poses[3:].copy())
                    yield number, _scan(parsed, lasers[kind])
                elif (text := line.strip()) and not _TEXT.match(text):
                    raise ValueError("does not begin with the name of a message")
            except ValueError as error:
                self.skip(number, _reason(kind, error))
        if damage:
            self.skip(len(lines), damage)

    def _calibrate(self, kind: bytes, lines: list[bytes]) -> LaserProperties:
        """Determine a laser's mount, unit and no-return value from lines spread over the log."""
        start = kind + b" "
        of_kind = [line for line in lines if line.startswith(start)]
        sample = list(_parsed(kind, of_kind[:: max(1, len(of_kind) // CALIBRATION_LINES)]))
        if not sample:
            return LaserProperties(None, math.inf, 1.0, has_odometry=False)
        poses = np.array([line.poses for line in sample])
        drive = (ScanInUnits(line.angles, line.readings, line.poses[:3]) for line in _parsed(kind, of_kind))
        per_metre = find_range_unit([line.readings for line in sample], drive, self)
        sample = [_in_metres(line, per_metre) for line in sample]
        no_return = find_no_return(
            [np.where(line.readings < _stated_limit(line), line.readings, np.nan) for line in sample]
        )
        limit = math.inf if no_return is None else no_return
        return LaserProperties(_estimate_mount(poses), limit, per_metre, has_odometry=bool(poses[:, 3:].any()))

    def _stamps(self, lines: list[bytes]) -> _Stamps:
        self.times_known = not clock_stands(lines)
        if self.times_known:
            return _Stamps(self._restored_stamps(lines))
        self.doubt(
            "most scans have the same stamp, so the times are not known: lines are read in their order, as if the "
            f"robot had driven {SPEED:g} m/s"
        )
        return _Stamps({}, PathClock())

    def _restored_stamps(self, lines: list[bytes]) -> dict[int, float]:
        """Return line number -> stamp for all stamps that have to be read differently from what is written."""
        restored = restore_microseconds(written for _, written in written_stamps(lines))
        if restored is None:
            return {}
        changed: dict[int, float] = {}
        recorded: dict[float, float] = {}
        right: set[float] = set()
        for (number, text), stamp in zip(written_stamps(lines), restored, strict=True):
            if stamp == (written := float(text)):
                right.add(stamp)
            else:
                changed[number], recorded[stamp] = stamp, written
        self.report.recorded_stamps = {stamp: written for stamp, written in recorded.items() if written not in right}
        self.interpret(
            f"microseconds are written without leading zeros; {len(changed)} stamps are restored by the order of lines"
        )
        return changed

    def _empty_reason(self) -> str:
        return "is not a CARMEN log: it has no readable ODOM, FLASER, RLASER or ROBOTLASER1 line"


def _content(path: Path) -> tuple[bytes, str | None]:
    """Return the log's bytes up to a damaged place, and the damage of its compression, None if there is none."""
    with path.open("rb") as file:
        magic = file.read(3)
        file.seek(0)
        if magic[:2] == b"\x1f\x8b":
            return _decompressed(path, gzip.GzipFile(fileobj=file), "gzip")
        if magic == b"BZh":
            return _decompressed(path, bz2.BZ2File(file), "bzip2")
        return file.read(), None


def _decompressed(path: Path, content: gzip.GzipFile | bz2.BZ2File, compression: str) -> tuple[bytes, str | None]:
    """Return the bytes of a compressed file up to a damaged place, and the damage, None if there is none.

    Raises RecordingError if they are too many.
    """
    pieces: list[bytes] = []
    left = allowed_size(path.stat().st_size)
    try:
        while piece := content.read(1 << 16):
            pieces.append(piece)
            left -= len(piece)
            if left < 0:
                reason = f"decompresses to more than {MAX_RATIO} times its size; to read it anyway, decompress it first"
                raise RecordingError(path, None, reason)
    except (EOFError, OSError, zlib.error) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # of the disk; those of damaged streams have no number
        return b"".join(pieces), f"{compression} stream is damaged or truncated"
    return b"".join(pieces), None


def _reason(kind: bytes, error: ValueError) -> str:
    """Return a reason without the line's own numbers, so that equal errors are counted together."""
    text = str(error)
    is_number_error = text.startswith(("could not convert", "invalid literal"))
    reason = "field is not a number" if is_number_error else text
    return f"{kind.decode()} line: {reason}" if kind in KINDS else f"line: {reason}"


def _scan(line: LaserLine, laser: LaserProperties) -> Scan:
    limit = min(_stated_limit(line), laser.no_return)
    valid = (line.readings > 0.0) & (line.readings < limit)  # false for nan
    ranges = np.where(valid, line.readings, np.nan)
    return Scan(line.stamp, ranges, line.angles, no_offsets(len(ranges)), 0.0, limit, laser.mount)


def _parsed(kind: bytes, lines: list[bytes]) -> Iterator[LaserLine]:
    """Yield the laser lines of a kind that can be parsed; the others are counted when they are read."""
    for line in lines:
        with suppress(ValueError):
            yield parse_laser(kind, line)


def _in_metres(line: LaserLine, per_metre: float) -> LaserLine:
    """Convert the readings of a laser line, and its limit if that has the same unit; return the line."""
    line.readings /= per_metre
    if line.limit is not None and line.limit > FAR:
        line.limit /= per_metre
    return line


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
