"""Memory that a run has freed or does not need any more, and its return to the system."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

M_TRIM_THRESHOLD = -1
"""Option of glibc's `mallopt`."""
M_MMAP_THRESHOLD = -3
"""The same."""
MADV_DONTNEED = 4
"""Advice of Linux' `madvise`: pages are not needed soon."""
LARGE_BLOCK = 4 << 20
"""Bytes of a block of memory that commands return to the system as soon as it is freed. Measured on Intel's recording:
297 MB instead of 304 at most, and 0.2 s of system time more; with 1 MB blocks it takes 0.6 s."""
LARGE_LIVE_BLOCK = 1 << 20
"""The same in live runs, whose memory would grow with each save."""


def return_large_blocks(size: int = LARGE_BLOCK) -> None:
    """Return blocks of memory of at least `size` bytes to the system when they are freed, from now on.

    By default glibc raises the size of such blocks to that of the largest one freed so far, up to 32 MB. Each save
    copies the growing record of the drive, and the copies before it then leave gaps that hardly fit others.

    With a size that is set, glibc shrinks the heap whenever 128 kB at its end are free, and the system clears each page
    that it gives again. So the heap is shrunk from twice the size on, as glibc does by default. No effect with other C
    libraries.
    """
    with suppress(OSError, AttributeError):
        library = _library()
        library.mallopt(M_MMAP_THRESHOLD, size)
        library.mallopt(M_TRIM_THRESHOLD, 2 * size)


def return_freed_memory() -> None:
    """Return all memory that is free now to the system; takes some hundredths of a second.

    glibc keeps it otherwise if blocks behind it are in use. No effect with other C libraries.
    """
    with suppress(OSError, AttributeError):
        _library().malloc_trim(0)


def return_code_of_imports() -> None:
    """Return the pages of libraries' code and constants to the system; those needed again are mapped again.

    Imports use far more of them than a run: with LLVM and GTSAM they take 80 MB. Linux keeps their contents in its file
    cache as long as nothing else needs that memory. Pages that were written to, as by the dynamic linker, are kept. No
    effect with other systems.
    """
    with suppress(OSError, AttributeError, ValueError):
        madvise = _library().madvise
        madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
        with Path("/proc/self/smaps").open(encoding="utf-8") as smaps:
            parts = _unwritten_library_parts(smaps)
        for begin, end in parts:
            madvise(begin, end - begin, MADV_DONTNEED)


@cache
def _library() -> ctypes.CDLL:
    """Return the C library. Each object of it has a class of its own, which stays until all objects are examined."""
    return ctypes.CDLL(None)


def _unwritten_library_parts(smaps: Iterable[str]) -> list[tuple[int, int]]:
    """Return begin and end of the read-only parts of shared libraries in which no page was written to."""
    parts: list[tuple[int, int]] = []
    current: tuple[int, int] | None = None
    for line in smaps:
        words = line.split()
        if words[0] == "Anonymous:" and current is not None and words[1] == "0":
            parts.append(current)
        elif not words[0].endswith(":"):  # "7f00-7f10 r-xp 00000000 fe:00 1234 /lib/libm.so.6"
            is_code = words[1] in ("r-xp", "r--p") and len(words) > 5 and ".so" in words[5]
            begin, _, end = words[0].partition("-")
            current = (int(begin, 16), int(end, 16)) if is_code else None
    return parts
