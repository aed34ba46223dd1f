"""How often the interpreter lets another thread run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

SWITCH_INTERVAL = 5e-4
"""Seconds after which the interpreter interrupts the run for the thread that receives messages, where it can."""


@contextmanager
def short_switch_interval() -> Iterator[None]:
    """Let threads that wait for the interpreter run after SWITCH_INTERVAL in the block.

    By default a thread waits for 5 ms each time, several times for one message.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
