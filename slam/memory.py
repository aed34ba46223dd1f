"""Memory that a run has freed, and its return to the system."""

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


def return_freed_memory() -> None:
    """Return all memory that is free now to the system; takes some hundredths of a second.

    glibc keeps it otherwise if blocks behind it are in use. No effect with other C libraries.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
