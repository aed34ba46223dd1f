"""Memory of a run that may last for days."""

from __future__ import annotations

import ctypes
from contextlib import suppress

M_MMAP_THRESHOLD = -3
"""Option of glibc's `mallopt`."""
LARGE_BLOCK = 1 << 20
"""Bytes of a block of memory that is returned to the system as soon as it is freed."""


def return_large_blocks() -> None:
    """Return large blocks of memory to the system when they are freed, from now on.

    By default glibc raises the size of such blocks to that of the largest one freed so far, up to 32 MB. Each save
    copies the growing record of the drive, and the copies before it then leave gaps that hardly fit others. No effect
    with other C libraries.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BLOCK)
