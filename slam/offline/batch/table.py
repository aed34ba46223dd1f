"""Status and results of the recordings of a batch as rows of a Parquet file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from ...io.unfinished_file import unfinished_file
from .figures import Figures
from .jobs import Job


class Status(StrEnum):
    """Status of a recording in a batch."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    KEPT = "kept"
    """Complete before the batch started."""
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Row:
    """Status and results of a recording; None if unknown.

    duration     seconds of the recording
    path_length  travelled distance, metres
    loops        loop closures that were accepted and not retracted
    seconds      computing time
    memory       largest memory of the worker's process, MiB
    error_rmse   root mean square error of the positions, metres, if the recording has ground truth
    error        reason of a failure
    """

    name: str
    recording: str
    status: Status
    duration: float | None = None
    path_length: float | None = None
    scans: int | None = None
    keyframes: int | None = None
    loops: int | None = None
    seconds: float | None = None
    memory: float | None = None
    error_rmse: float | None = None
    error: str | None = None
    log: str | None = None


SCHEMA = pa.schema(
    [(name, pa.string()) for name in ("name", "recording", "status")]
    + [(name, pa.float64()) for name in ("duration", "path_length")]
    + [(name, pa.int64()) for name in ("scans", "keyframes", "loops")]
    + [(name, pa.float64()) for name in ("seconds", "memory", "error_rmse")]
    + [(name, pa.string()) for name in ("error", "log")]
)


def make_row(job: Job, status: Status, summary: dict[str, Any] | None = None, error: str | None = None) -> Row:
    """Return the row of a job, with figures from the summary of its run if there is one."""
    log = str(job.log) if job.log.exists() else None
    if summary is None:
        return Row(job.name, job.recording, status, error=error, log=log)
    figures = Figures.model_validate(summary)
    return Row(
        job.name,
        job.recording,
        status,
        duration=figures.duration,
        path_length=figures.path_length,
        scans=figures.scans,
        keyframes=figures.keyframes,
        loops=figures.closures,
        seconds=figures.wall_seconds,
        memory=figures.peak_memory_mib,
        error_rmse=None if figures.truth is None else figures.truth.ate_rmse,
        error=error,
        log=log,
    )


def write_table(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as a Parquet file, which replaces an older one atomically. Raises OutputError."""
    with unfinished_file(path, overwrite=True) as unfinished:
        pq.write_table(pa.Table.from_pylist([_values(row) for row in rows], SCHEMA), unfinished)


def _values(row: Row) -> dict[str, Any]:
    """Return the values of a row; the names of files need not be UTF-8, but texts of the table must."""
    values = asdict(row).items()
    return {
        name: value.encode(errors="replace").decode() if isinstance(value, str) else value for name, value in values
    }
