"""Status of each recording of a batch: in a file, as a progress bar while it runs, and as a final table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from ...errors import OutputError
from ...formatting import duration
from ...offline.batch import Job, Row, Status, make_row, read_completed_summary, write_table

FILE_WIDTH = 200
"""Width of the table if the output is not a terminal, columns."""


class BatchStatus:
    """Status table with one row per job, in their order; written to `path` with every change."""

    def __init__(self, jobs: Sequence[Job], path: Path) -> None:
        self._rows = {job.name: self._found(job) for job in jobs}
        self._jobs = jobs
        self._path = path
        self._screen = Console(stderr=True)
        write_table(path, self._rows.values())

    @staticmethod
    def _found(job: Job) -> Row:
        """Return the row of a job before the batch begins."""
        if job.overwrite:
            return make_row(job, Status.WAITING)
        try:
            summary = read_completed_summary(job)
        except OutputError as error:
            return make_row(job, Status.FAILED, error=str(error))
        return make_row(job, Status.WAITING if summary is None else Status.KEPT, summary)

    @property
    def waiting(self) -> list[Job]:
        """Jobs that are not mapped yet."""
        return [job for job in self._jobs if self._rows[job.name].status == Status.WAITING]

    @property
    def complete(self) -> int:
        """Number of recordings with complete results."""
        return sum(row.status in (Status.DONE, Status.KEPT) for row in self._rows.values())

    def __len__(self) -> int:
        return len(self._rows)

    def follow(self, rows: Iterator[Row]) -> None:
        """Update the table with rows as they arrive, and show the progress.

        At the end, also after an exception, running jobs are set to waiting.
        """
        try:
            with self._bar() as bar:
                task = bar.add_task("recordings", total=len(self), completed=len(self) - len(self.waiting))
                for row in rows:
                    self._rows[row.name] = row
                    write_table(self._path, self._rows.values())
                    if row.status != Status.RUNNING:
                        bar.console.print(_line(row), markup=False, highlight=False, soft_wrap=True)
                        bar.advance(task)
        finally:
            for name, row in self._rows.items():
                if row.status == Status.RUNNING:
                    self._rows[name] = replace(row, status=Status.WAITING)
            write_table(self._path, self._rows.values())

    @contextmanager
    def _bar(self) -> Iterator[Progress]:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        hidden = not self._screen.is_terminal
        with Progress(*columns, console=self._screen, transient=True, disable=hidden) as bar:
            yield bar

    def show(self) -> None:
        """Print the table, then the errors, on stdout."""
        table = Table(box=None, pad_edge=False)
        table.add_column("recording", overflow="fold")
        for heading in ("status", "duration", "path", "scans", "keyframes", "loops", "time", "memory"):
            table.add_column(heading, justify="left" if heading == "status" else "right", no_wrap=True)
        for row in self._rows.values():
            figures = row.figures
            counts = figures.scans, figures.keyframes, figures.closures
            table.add_row(
                row.name,
                row.status.value,
                "" if figures.duration is None else duration(figures.duration),
                "" if figures.path_length is None else f"{figures.path_length:.0f} m",
                *("" if count is None else str(count) for count in counts),
                "" if figures.wall_seconds is None else duration(figures.wall_seconds),
                "" if figures.peak_memory_mib is None else f"{figures.peak_memory_mib:.0f} MiB",
            )
        screen = Console(highlight=False, markup=False)
        if not screen.is_terminal:
            screen.width = FILE_WIDTH
        screen.print(table)
        for row in self._rows.values():
            if row.error is not None:
                screen.print(_line(row), soft_wrap=True)


def _line(row: Row) -> str:
    """Return the status of a recording in one line."""
    if row.error is not None:
        return f"{row.name}: {row.status.value}: {row.error}"
    seconds = row.figures.wall_seconds
    return f"{row.name}: {row.status.value}" + ("" if seconds is None else f" in {duration(seconds)}")
