"""Trajectories in memory, and in the TUM format that evo and other tools read: `t x y z qx qy qz qw` per line."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers import se2
from drivers.immutable import immutable
from drivers.path_length import path_length

from ..bounds import MAX_LENGTH
from ..errors import MapError
from ..formatting import counted
from ..geometry.segments import Floats

STAMP_TOLERANCE = 1e-3
"""Seconds between a pose and a stamp that count as equal: recordings round their stamps to milliseconds."""
COLUMNS = 8
BLOCK = 10_000
"""Poses that are written at once, so that a trajectory of days needs little memory."""
QUATERNION_TOLERANCE = 0.01
"""Largest difference of a quaternion's length from one: files are often written with three decimals."""


@immutable
class Lookup:
    """Poses of a trajectory at n stamps.

    poses    (n, 3) metres, radians; headings are continuous along the trajectory, not wrapped
    exact    (n,) True if the trajectory has a pose at the stamp; else the pose is interpolated between its neighbours
    covered  (n,) True if the stamp lies within the trajectory's time; else the pose is that of the nearer end
    """

    poses: Floats
    exact: NDArray[np.bool_]
    covered: NDArray[np.bool_]


@immutable
class Trajectory:
    """At least one pose over time.

    stamps  (n,) seconds, never decreasing
    poses   (n, 3) [x, y, heading] in metres and radians

    Raises MapError if shapes disagree, a value is not finite, or stamps decrease.
    """

    stamps: Floats
    poses: Floats

    def __post_init__(self) -> None:
        if len(self.stamps) == 0:
            raise MapError("the trajectory has no pose")
        if self.stamps.ndim != 1 or self.poses.shape != (len(self.stamps), 3):
            raise MapError(f"a trajectory of {self.stamps.shape} stamps needs as many poses, not {self.poses.shape}")
        if not (np.isfinite(self.stamps).all() and np.isfinite(self.poses).all()):
            raise MapError("the trajectory has values that are not finite")
        if np.any(np.diff(self.stamps) < 0):
            raise MapError("the trajectory's stamps decrease")

    @classmethod
    def sorted(cls, stamps: Floats, poses: Floats) -> Trajectory:
        """Return the trajectory of poses (n, 3) in any order of their stamps (n,)."""
        order = np.argsort(stamps, kind="stable")
        return cls(stamps[order], poses[order])

    def __len__(self) -> int:
        return len(self.stamps)

    def __repr__(self) -> str:
        return f"<Trajectory: {counted(len(self), 'pose')}, {self.duration:.1f} s, {self.length:.1f} m driven>"

    @property
    def duration(self) -> float:
        """Seconds from the first to the last pose."""
        return float(self.stamps[-1] - self.stamps[0])

    @property
    def length(self) -> float:
        """Travelled distance, metres; see `path_length`."""
        return path_length(self.poses[:, :2])

    def at(self, stamps: ArrayLike) -> Lookup:
        """Return the poses at `stamps` (n,): the nearest within STAMP_TOLERANCE, else interpolated."""
        wanted = np.atleast_1d(np.asarray(stamps, dtype=np.float64))
        poses = np.column_stack([self.poses[:, :2], np.unwrap(self.poses[:, 2])])
        nearest = self.nearest(wanted)
        exact = np.abs(self.stamps[nearest] - wanted) < STAMP_TOLERANCE
        interpolated = np.column_stack([np.interp(wanted, self.stamps, column) for column in poses.T])
        covered = (wanted >= self.stamps[0] - STAMP_TOLERANCE) & (wanted <= self.stamps[-1] + STAMP_TOLERANCE)
        return Lookup(np.where(exact[:, None], poses[nearest], interpolated), exact, covered)

    def nearest(self, stamps: ArrayLike) -> NDArray[np.intp]:
        """Return for each of `stamps` (n,) the index of the pose with the nearest stamp, the later one of a tie."""
        wanted = np.asarray(stamps, dtype=np.float64)
        later = np.searchsorted(self.stamps, wanted).clip(0, len(self) - 1)
        earlier = (later - 1).clip(0)
        is_earlier = np.abs(self.stamps[earlier] - wanted) < np.abs(self.stamps[later] - wanted)
        return np.where(is_earlier, earlier, later)


def distance_along(positions: Floats) -> Floats:
    """Return (n,) the length of the path through `positions` (n, 2) from the first to each, metres."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions, axis=0).T))])


def write_tum(path: Path | str, trajectory: Trajectory, stamps: Floats | None = None) -> None:
    """Write a trajectory with microseconds, micrometres and nine decimals of the quaternion.

    stamps  (n,) seconds, written instead of the trajectory's own; they may go back
    """
    stamps = trajectory.stamps if stamps is None else stamps
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        for begin in range(0, len(stamps), BLOCK):
            file.writelines(_lines(stamps[begin : begin + BLOCK], trajectory.poses[begin : begin + BLOCK]))


def _lines(stamps: Floats, poses: Floats) -> Iterator[str]:
    half = 0.5 * se2.wrap(poses[:, 2])
    columns = np.column_stack([poses[:, :2], np.sin(half), np.cos(half)])
    columns = np.round(columns, 9) + 0.0  # turns -0.0 into 0.0
    for stamp, (x, y, qz, qw) in zip(stamps.tolist(), columns.tolist(), strict=True):
        yield f"{stamp:.6f} {x:z.6f} {y:z.6f} 0.000000 0 0 {qz:z.9f} {qw:z.9f}\n"


def read_tum(path: Path | str) -> Trajectory:
    """Read a trajectory; height and tilt are ignored, poses are sorted by stamp, `#` starts a comment.

    Raises MapError naming the file and, if possible, the line.
    """
    return Trajectory.sorted(*read_tum_poses(path))


def read_tum_poses(path: Path | str) -> tuple[Floats, Floats]:
    """Read the stamps (n,) and poses (n, 3) of a trajectory like `read_tum`, in the order of the lines.

    Raises MapError naming the file and, if possible, the line.
    """
    rows = read_table(path, COLUMNS, "t x y z qx qy qz qw")
    length = np.linalg.norm(rows.values[:, 4:], axis=1)
    if np.any(wrong := np.abs(length - 1) > QUATERNION_TOLERANCE):
        row = int(np.argmax(wrong))
        raise MapError(f"{path}:{rows.lines[row]}: the quaternion's length is {length[row]:.3g}, not 1")
    values = rows.values
    if np.any(far := np.abs(values[:, 1:3]).max(axis=1) > MAX_LENGTH):
        raise MapError(f"{path}:{rows.lines[int(np.argmax(far))]}: the position is beyond {MAX_LENGTH:g} m")
    heading = 2 * np.arctan2(values[:, 6], values[:, 7])
    return values[:, 0], np.column_stack([values[:, 1:3], se2.wrap(heading)])


@immutable
class NumberTable:
    """Numbers from a text file: `values` (n, columns), and the line of each row, from 1."""

    values: Floats
    lines: list[int]


def read_table(path: Path | str, columns: int, meaning: str) -> NumberTable:
    """Read rows of `columns` finite numbers separated by white space; empty lines and `#` comments are skipped.

    Raises MapError naming the file, the line, and the expected columns (`meaning`).
    """
    rows: list[list[float]] = []
    lines: list[int] = []
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise MapError(f"{path}: is not a text file; expected lines of {meaning}") from error
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != columns:
            raise MapError(f"{path}:{number}: expected {columns} numbers ({meaning}), found {len(words)}")
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise MapError(f"{path}:{number}: expected {columns} numbers ({meaning}): {error}") from error
        if not all(map(math.isfinite, row)):
            raise MapError(f"{path}:{number}: not all values are finite")
        rows.append(row)
        lines.append(number)
    if not rows:
        raise MapError(f"{path}: has no line of {columns} numbers ({meaning})")
    return NumberTable(np.array(rows), lines)
