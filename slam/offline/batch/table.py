"""Status and results of the recordings of a batch as rows of a Parquet file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
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


SCHEMA = pa.schema(
    [(name, pa.string()) for name in ("name", "recording", "status")]
    + [(name, pa.float64()) for name in ("duration", "path_length")]
    + [(name, pa.int64()) for name in ("scans", "keyframes", "loops")]
    + [(name, pa.float64()) for name in ("seconds", "memory", "error_rmse")]
    + [(name, pa.string()) for name in ("error", "log")]
)


@dataclass(frozen=True, slots=True)
class Row:
    """Status and results of a recording.

    figures  of its run; unknown ones if it is not mapped
    error    reason of a failure
    log      file of its log, if there is one
    """

    name: str
    recording: str
    status: Status
    figures: Figures
    error: str | None
    log: str | None

    def values(self) -> dict[str, str | float | None]:
        """Return the values of the columns."""
        figures = self.figures
        return {
            "name": _encodable(self.name),
            "recording": _encodable(self.recording),
            "status": self.status.value,
            "duration": figures.duration,
            "path_length": figures.path_length,
            "scans": figures.scans,
            "keyframes": figures.keyframes,
            "loops": figures.closures,
            "seconds": figures.wall_seconds,
            "memory": figures.peak_memory_mib,
            "error_rmse": figures.error_rmse,
            "error": None if self.error is None else _encodable(self.error),
            "log": None if self.log is None else _encodable(self.log),
        }


def _encodable(text: str) -> str:
    """Return a text with "?" in place of what UTF-8 cannot encode, such as bytes of the names of files."""
    return text.encode(errors="replace").decode()


def make_row(job: Job, status: Status, summary: dict[str, Any] | None = None, error: str | None = None) -> Row:
    """Return the row of a job, with figures from the summary of its run if there is one."""
    figures = Figures.model_validate(summary or {})
    return Row(job.name, job.recording, status, figures, error, str(job.log) if job.log.exists() else None)


def write_table(path: Path, rows: Iterable[Row]) -> None:
    """Write rows as a Parquet file, which replaces an older one atomically. Raises OutputError."""
    with unfinished_file(path, overwrite=True) as unfinished:
        pq.write_table(pa.Table.from_pylist([row.values() for row in rows], SCHEMA), unfinished)
