"""Real-time priority for what must not wait for a processor."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress


def request_realtime_priority() -> None:
    """Give this thread, and those it starts, the lowest real-time priority, if permitted."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))


@contextmanager
def realtime_priority() -> Iterator[None]:
    """Run the block with real-time priority, if permitted."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    request_realtime_priority()
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)
