"""`wclm batch`: many recordings at once."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...errors import OutputError
from ..console import EXIT_INTERRUPTED, print_if_slow, print_message
from ..options import ConfigOption, PlotOption, RefineOption, ReviewOption, SetOption

if TYPE_CHECKING:
    from ...offline.batch.cluster import Client

EXIT_PARTIAL = 1
"""Exit status where the batch went to its end, but not every recording could be mapped."""
TABLE = "batch.parquet"
RETRIES = 2


def batch(
    recordings: Annotated[
        list[str], typer.Argument(help="Recordings as for `wclm run`: files, bags, simulations (sim:office?seed=3).")
    ],
    out: Annotated[Path, typer.Option("--out", help="Directory for a directory of results for each recording.")],
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster whose workers see the same files."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes on this computer; without it, one for each core.")
    ] = None,
    retries: Annotated[
        int, typer.Option("--retries", min=0, help="How often to try again when a worker dies or something breaks.")
    ] = RETRIES,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Map again what is complete, and replace what is of another recording.")
    ] = False,
    refine: RefineOption = False,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Map many recordings in parallel, each as `wclm run` does; the same command again goes on after an interruption.

    What is complete, of the same recordings and with the same settings, is kept. A recording that fails harms no other;
    the exit status is 1 then. What came of each is in DIR/batch.parquet, how it went in DIR/logs.

    Example: [bold]wclm batch monday/*.mcap --out maps --workers 4[/bold]
    """
    from ...config import load_config
    from ...offline.batch import Request, jobs_for, remove_leftovers
    from ...offline.batch.dispatch import dispatch
    from .batch_status import BatchStatus
    from .batch_worker import map_job

    if scheduler is not None and workers is not None:
        raise typer.BadParameter("a cluster has the workers that it has", param_hint="--workers")
    request = Request(load_config(config, settings or ()), refine=refine, review=review, picture=plot)
    jobs = jobs_for(recordings, out, request, overwrite=overwrite)
    _make(out)
    ledger = BatchStatus(jobs, out / TABLE)
    to_do = ledger.to_do
    try:
        if to_do:
            with _cluster(scheduler, min(workers or os.cpu_count() or 1, len(to_do))) as client:
                ledger.process_messages(dispatch(to_do, map_job, client, retries))
    except KeyboardInterrupt as error:
        print_message(f"interrupted; {ledger.complete} of {len(ledger)} are complete, the same command again goes on")
        raise typer.Exit(EXIT_INTERRUPTED) from error
    finally:
        if scheduler is None:  # on a cluster, what is under way comes to its end
            for job in to_do:
                remove_leftovers(job)
    ledger.show()
    if ledger.complete < len(ledger):
        raise typer.Exit(EXIT_PARTIAL)


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be made: {error.strerror or error}") from error


def _cluster(scheduler: str | None, count: int) -> AbstractContextManager[Client]:
    from ...offline.batch.cluster import local_workers, workers_of

    if scheduler is not None:
        return workers_of(scheduler)
    from ...warmup import warm_up
    from ..slam_run import COMPILING

    with print_if_slow(COMPILING):
        warm_up()  # here, once: the workers find on disk what else each of them would compile
    return local_workers(count)
