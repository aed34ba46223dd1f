"""Requests of one command to a live run of another process."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from ..errors import OutputError
from ..io.work_directory import RunAnnouncement, running_process

TIMEOUT = 120.0
"""Seconds to wait for an answer: a slow disk needs some seconds for a map."""
POLL_PERIOD = 0.1
"""Seconds."""


def find_run(out: Path) -> RunAnnouncement:
    """Return what is known of the live run that writes the output directory `out`. Raises OutputError without one."""
    control = running_process(out)
    if control is None or control.frozen is None:
        raise OutputError(f"{out}: no live run is writing it")
    return control


def send_request(
    out: Path, before: RunAnnouncement, number: signal.Signals, answers: Callable[[RunAnnouncement], int]
) -> RunAnnouncement | None:
    """Send a signal to a live run and wait for its answer; return what it announced then, None if it has ended instead.

    before   what was known of the run
    answers  returns how often the run has answered such requests

    Raises OutputError if it does not answer.
    """
    os.kill(before.process, number)
    end = time.monotonic() + TIMEOUT
    while (now := running_process(out)) is not None and answers(now) == answers(before):
        if time.monotonic() > end:
            raise OutputError(f"{out}: the live run has not answered within {TIMEOUT:g} s")
        time.sleep(POLL_PERIOD)
    return now
