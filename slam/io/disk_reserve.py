"""Disk space that is reserved for results: they can be written even if the disk fills up during a run."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

MIN_RESERVE = 16_000_000
"""Bytes: twice the map and the session of a drive of 45 minutes."""


class DiskReserve:
    """A file that holds disk space until it is released."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def hold(self, size: int) -> None:
        """Hold `size` bytes. Raises OSError if there is not enough space; then nothing is held."""
        self.release()
        with self._path.open("wb") as file:
            try:
                os.posix_fallocate(file.fileno(), 0, size)
            except OSError:
                self.release()
                raise

    def hold_up_to(self, size: int) -> None:
        """Hold `size` bytes, or less if there is less space."""
        with suppress(OSError):
            self.hold(size)
            return
        with suppress(OSError):
            self.hold(free_space(self._path.parent))

    def release(self) -> None:
        """Free the space; further calls do nothing."""
        self._path.unlink(missing_ok=True)


def free_space(folder: Path) -> int:
    """Return the free bytes on the disk of a folder."""
    return shutil.disk_usage(folder).free


def directory_size(folder: Path) -> int:
    """Return the bytes of all files below a folder."""
    return sum(entry.stat().st_size for entry in folder.rglob("*") if entry.is_file())
