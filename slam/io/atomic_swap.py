"""Exchange two directories atomically, if the system supports that, and put files on the disk before."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""Constants of Linux's renameat2(2)."""
UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)
"""Errors of renameat2 if the system or file system does not support the exchange."""


def swap_directories(first: Path, second: Path) -> bool:
    """Exchange the names of two directories of one file system atomically.

    Returns False if the system does not support it. Raises OSError if it does, but the exchange fails.
    """
    rename = _renameat2()
    if rename is None:
        return False
    if rename(AT_FDCWD, os.fsencode(first), AT_FDCWD, os.fsencode(second), RENAME_EXCHANGE) == 0:
        return True
    error = ctypes.get_errno()
    if error in UNSUPPORTED:
        return False
    raise OSError(error, os.strerror(error), str(second))


@cache
def _renameat2() -> Callable[..., int] | None:
    """Return the function of the C library, None if it has none; a live run needs it at each save."""
    return getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if sys.platform == "linux" else None


def exchange_directories(new: Path, target: Path) -> None:
    """Rename a directory to `target`; if that exists, it gets the other's name.

    If the system does not support an atomic exchange, the old directory is renamed first, and back if the new one
    cannot be renamed. Raises OSError.
    """
    if not target.exists():
        new.rename(target)
        return
    if swap_directories(new, target):
        return
    aside = target.rename(new.with_name(f"{new.name}-aside"))
    try:
        new.rename(target)
    except OSError:
        aside.rename(target)
        raise
    aside.rename(new)


def sync_directory(folder: Path) -> None:
    """Wait until a directory and all files below it are on the disk. Raises OSError."""
    for entry in [*folder.rglob("*"), folder]:
        sync_file(entry)


def sync_file(path: Path) -> None:
    """Wait until a file, or the names in a directory, are on the disk. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
