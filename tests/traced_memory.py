"""Memory that Python allocates while a block of a test runs."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(slots=True)
class TracedMemory:
    """Bytes allocated in a block; known after it.

    kept  still allocated at its end
    peak  allocated at the same time at most
    """

    kept: int = 0
    peak: int = 0


@contextmanager
def traced_memory() -> Iterator[TracedMemory]:
    """Trace the memory of a block, without effects on later tests if it fails."""
    memory = TracedMemory()
    tracemalloc.start()
    try:
        yield memory
        memory.kept, memory.peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
