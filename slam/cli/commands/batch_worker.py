"""Mapping one recording of a batch in a worker process."""

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

from drivers.errors import SlamError

from ...io.recordings import open_to_map
from ...offline.batch import Job, Row, Status, fingerprint, make_row, read_completed_summary, remove_leftovers
from ...offline.batch.jobs import FINGERPRINT
from ...run_setup import RunSetup
from ..run_input import RecordingInput
from ..run_summary import format_summary
from ..setup_from_options import without_odometry
from ..slam_run import run_slam

MEMORY_COUNTERS = Path("/proc/self/clear_refs")
"""Linux: writing RESET_PEAK to this file resets the peak memory of the process."""
RESET_PEAK = "5"


def map_job(job: Job) -> Row:
    """Map a recording as `wclm run` does and write all output to the job's log.

    Returns a row with the error if that is a SlamError; raises other exceptions.
    """
    with _log(job.log) as log:
        try:
            # a worker that ended before it returned may have completed it
            summary = None if job.overwrite else read_completed_summary(job)
            if summary is None:
                remove_leftovers(job)
                summary = _map(job, log)
        except SlamError as error:
            _write(log, f"failed: {error}")
            return make_row(job, Status.FAILED, error=" ".join(str(error).split()))
        except Exception:
            _write(log, f"failed:\n{traceback.format_exc()}")
            raise
        _write(log, "done")
        return make_row(job, Status.DONE, summary)


class _FingerprintedInput(RecordingInput):
    """A recording whose summary contains the fingerprint of the job.

    setup  of the run
    """

    def __init__(self, job: Job) -> None:
        self._fingerprint = fingerprint(job)  # before reading: a change meanwhile is detected next time
        source, reason = open_to_map(job.recording, job.options.config)
        super().__init__(source, reopen=job.recording)
        self.setup = RunSetup(job.options.config)
        if reason is not None:
            self.setup = without_odometry(self.setup, f"{source.name}: {reason}")

    def facts(self) -> dict[str, Any]:
        return super().facts() | {FINGERPRINT: self._fingerprint}


def _map(job: Job, log: TextIO) -> dict[str, Any]:
    _reset_peak_memory()
    options = job.options
    run_input = _FingerprintedInput(job)
    result = run_slam(
        run_input,
        run_input.setup,
        job.directory,
        overwrite=True,
        review=options.review,
        picture=options.picture,
        refine=options.refine,
    )
    for line in [*format_summary(result, job.directory), *result.summary["warnings"]]:
        log.write(f"{line}\n")
    return result.summary


@contextmanager
def _log(path: Path) -> Iterator[TextIO]:
    """Append to the job's log; stdout, stderr and the traceback of a crash go there as well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8", buffering=1) as log, redirect_stdout(log), redirect_stderr(log):
        _write(log, f"started by process {os.getpid()} of {platform.node()}")
        faulthandler.enable(log)
        try:
            yield log
        finally:
            faulthandler.disable()


def _write(log: TextIO, text: str) -> None:
    log.write(f"{datetime.now():%Y-%m-%d %H:%M:%S} {text}\n")


def _reset_peak_memory() -> None:
    """Reset the peak memory, so that it does not include earlier recordings of this worker. Linux only."""
    with suppress(OSError):
        MEMORY_COUNTERS.write_text(RESET_PEAK)
