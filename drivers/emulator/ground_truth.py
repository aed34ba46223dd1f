"""The true path of the robot as a file in the TUM format: lines of `t x y z qx qy qz qw`."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import numpy as np

from ..errors import RecordingError
from .robot_motion import RobotMotion

PERIOD = 0.02
"""Seconds between lines."""


class GroundTruthWriter:
    """Writer of the true path as the robot drives. Raises RecordingError if the file cannot be written.

    begun  wall-clock time (seconds since 1970) at the emulator's time zero
    """

    def __init__(self, path: Path, motion: RobotMotion, begun: float) -> None:
        self._path, self._motion, self._begun = path, motion, begun
        self._lines = 0
        try:
            self._file = path.open("w", encoding="ascii", buffering=1)
        except OSError as failure:
            raise RecordingError(path, None, f"cannot be written: {failure.strerror}") from failure

    def advance(self, time: float) -> None:
        """Write the poses up to a time."""
        count = int(time / PERIOD) + 1 - self._lines
        if count <= 0:
            return
        times = (self._lines + np.arange(count)) * PERIOD
        self._lines += count
        poses = self._motion.poses(np.asarray(times, dtype=np.float64))
        try:
            for moment, (x, y, heading) in zip(times, poses, strict=True):
                qz, qw = np.sin(heading / 2), np.cos(heading / 2)
                self._file.write(f"{self._begun + moment:.9f} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n")
        except OSError as failure:
            raise RecordingError(self._path, None, f"cannot be written: {failure.strerror}") from failure

    def __enter__(self) -> GroundTruthWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
