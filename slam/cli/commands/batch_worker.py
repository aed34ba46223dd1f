"""One recording of a batch, in the process of a worker."""

from __future__ import annotations

import faulthandler
import os
import platform
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

import drivers
from drivers.errors import SlamError

from ...offline.batch import Job, Row, Status, completed, fingerprint, remove_leftovers, row_of
from ...offline.batch.jobs import FINGERPRINT
from ..run_input import RecordingInput
from ..run_summary import format_summary
from ..slam_run import run_slam

MEMORY_COUNTERS = Path("/proc/self/clear_refs")
RESET_PEAK = "5"  # what Linux takes for it


def map_job(job: Job) -> Row:
    """Map a recording as `wclm run` does, with everything there is to say in the job's log.

    An error that a user can mend is in the row; others are raised.
    """
    with _log(job.log) as log:
        try:
            summary = None if job.overwrite else completed(job)  # by a worker that died before it told
            if summary is None:
                remove_leftovers(job)
                summary = _map(job, log)
        except SlamError as error:
            _say(log, f"failed: {error}")
            return row_of(job, Status.FAILED, error=" ".join(str(error).split()))
        except Exception:
            _say(log, f"failed:\n{traceback.format_exc()}")
            raise
        _say(log, "done")
        return row_of(job, Status.DONE, summary)


class _Marked(RecordingInput):
    """A recording whose summary tells what the results were made of."""

    def __init__(self, job: Job) -> None:
        super().__init__(drivers.open(job.recording), reopen=job.recording)
        self._facts = {FINGERPRINT: fingerprint(job)}  # before it is read: a change meanwhile shows next time

    def facts(self) -> dict[str, Any]:
        return self._facts


def _map(job: Job, log: TextIO) -> dict[str, Any]:
    _forget_peak_memory()
    wanted = job.request
    result = run_slam(
        _Marked(job),
        wanted.config,
        job.directory,
        overwrite=True,
        review=wanted.review,
        picture=wanted.picture,
        refine=wanted.refine,
    )
    for line in [*format_summary(result, job.directory), *result.summary["warnings"]]:
        log.write(f"{line}\n")
    return result.summary


@contextmanager
def _log(path: Path) -> Iterator[TextIO]:
    """The log, after what earlier tries left in it; what libraries print goes there too, and where a crash happened."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8", buffering=1) as log, redirect_stdout(log), redirect_stderr(log):
        _say(log, f"started by process {os.getpid()} of {platform.node()}")
        faulthandler.enable(log)
        try:
            yield log
        finally:
            faulthandler.disable()


def _say(log: TextIO, text: str) -> None:
    log.write(f"{datetime.now():%Y-%m-%d %H:%M:%S} {text}\n")


def _forget_peak_memory() -> None:
    """A worker maps many recordings; the memory that is told of one is not to be an earlier one's. Linux only."""
    with suppress(OSError):
        MEMORY_COUNTERS.write_text(RESET_PEAK)
