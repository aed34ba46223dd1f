"""`wclm batch`: many recordings in parallel."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..compilation import compile_for_recording
from ..console import EXIT_INTERRUPTED, print_message
from ..options import ConfigOption, PlotOption, RefineOption, ReviewOption, SetOption
from ..output_files import make_directory

if TYPE_CHECKING:
    from ...offline.batch.cluster import Client
    from .batch_status import BatchStatus

EXIT_PARTIAL = 1
"""Exit status if the batch is complete but some recordings could not be mapped."""
TABLE = "batch.parquet"
RETRIES = 2


def batch(
    recordings: Annotated[
        list[str],
        typer.Argument(metavar="RECORDING", help="Recordings: files, bags, simulations (sim:office?seed=3)."),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Directory for the output directories of the recordings.")
    ],
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Address of a Dask cluster whose workers have access to the same files.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="Number of processes on this computer; by default one per core."),
    ] = None,
    retries: Annotated[
        int,
        typer.Option("--retries", min=0, help="Number of retries after a crash of a worker or an unexpected error."),
    ] = RETRIES,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Map completed recordings again and replace results of other recordings."),
    ] = False,
    refine: RefineOption = False,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Map many recordings in parallel, each as `wclm run` does.

    Repeating the command continues an interrupted batch: complete results of the same recordings and settings are kept.
    If a recording fails, the others are still mapped and the exit status is 1. DIR/batch.parquet has one row per
    recording, DIR/logs one log.

    Example: [bold]wclm batch monday/*.mcap --out maps --workers 4[/bold]
    """
    from ...config import load_config
    from ...extras import require_extra
    from ...offline.batch import JobOptions, make_jobs
    from .batch_status import BatchStatus

    require_extra("batch")
    if scheduler is not None and workers is not None:
        raise typer.BadParameter("the number of workers of a cluster cannot be set", param_hint="--workers")
    options = JobOptions(load_config(config, settings or ()), refine=refine, review=review, picture=plot)
    jobs = make_jobs(recordings, out, options, overwrite=overwrite)
    make_directory(out)
    status = BatchStatus(jobs, out / TABLE)
    _map_waiting(status, scheduler, workers or os.cpu_count() or 1, retries)
    status.show()
    if status.complete < len(status):
        raise typer.Exit(EXIT_PARTIAL)


def _map_waiting(status: BatchStatus, scheduler: str | None, workers: int, retries: int) -> None:
    """Map the recordings that are not complete, on a cluster or with local processes; raises Exit if interrupted."""
    from ...offline.batch import remove_leftovers
    from ...offline.batch.dispatch import dispatch
    from .batch_worker import map_job

    waiting = status.waiting
    try:
        if waiting:
            with _cluster(scheduler, min(workers, len(waiting))) as client:
                status.follow(dispatch(waiting, map_job, client, retries))
    except KeyboardInterrupt as error:
        print_message(
            f"interrupted; {status.complete} of {len(status)} recordings are complete; repeat the command to continue"
        )
        raise typer.Exit(EXIT_INTERRUPTED) from error
    finally:
        if scheduler is None:  # on a cluster, running jobs continue to their end
            for job in waiting:
                remove_leftovers(job)


def _cluster(scheduler: str | None, count: int) -> AbstractContextManager[Client]:
    from ...offline.batch.cluster import connect_to_workers, start_local_workers

    if scheduler is not None:
        return connect_to_workers(scheduler)
    compile_for_recording()  # once, here: the workers load the compiled functions from disk
    return start_local_workers(count)
