"""Dispatch jobs to workers, one at a time to each, and yield their outcomes as they arrive."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING
from uuid import uuid4

from .jobs import Job
from .table import Row, Status, make_row

if TYPE_CHECKING:
    from distributed import Client, Future

POLL_INTERVAL = 0.5
"""Seconds between two checks for workers that are new or were restarted."""
CLUSTER_LOST = "the connection to the cluster was lost"
WORKER_DIED = "the worker process died while mapping it"

JobFunction = Callable[[Job], Row]
"""Function that a worker calls with a job. Errors of the recording are in the row; if it raises, the job is retried."""


def dispatch(jobs: Sequence[Job], function: JobFunction, client: Client, retries: int) -> Iterator[Row]:
    """Yield the rows of jobs: one when a worker starts a job (RUNNING), one when the job has ended.

    A worker has one job at a time, so it is known which job killed its worker, and no job waits at a worker that dies.
    Such a job, and one for which `function` raises, is retried after the others, at most `retries` times.
    """
    waiting, tries = deque(jobs), Counter[str]()
    running: dict[Future[Row], tuple[Job, str]] = {}
    while waiting or running:
        for worker in _idle_workers(client, {worker for _, worker in running.values()}):
            if waiting:
                job = waiting.popleft()
                tries[job.name] += 1
                key = f"{job.name}-{uuid4().hex}"
                future = client.submit(function, job, key=key, workers=[worker], allow_other_workers=True, pure=False)
                running[future] = job, worker
                yield make_row(job, Status.RUNNING)
        for future in _wait_for_ended(running):
            job, _ = running.pop(future)
            row = _outcome(job, future)
            if row is None and tries[job.name] <= retries:
                waiting.append(job)
                continue
            yield row or make_row(job, Status.FAILED, error=_reason(future))
        if client.status == "closed":
            yield from (make_row(job, Status.FAILED, error=CLUSTER_LOST) for job in waiting)
            return


def _idle_workers(client: Client, busy: set[str]) -> list[str]:
    """Return the addresses of the present workers that are not busy."""
    return [worker for worker in client.scheduler_info(n_workers=-1)["workers"] if worker not in busy]


def _wait_for_ended(running: dict[Future[Row], tuple[Job, str]]) -> list[Future[Row]]:
    """Wait up to POLL_INTERVAL for the first to end and return all that have ended."""
    from distributed import wait

    if not running:
        time.sleep(POLL_INTERVAL)
        return []
    with suppress(TimeoutError):
        wait(list(running), timeout=POLL_INTERVAL, return_when="FIRST_COMPLETED")
    return [future for future in running if future.done()]


def _outcome(job: Job, future: Future[Row]) -> Row | None:
    """Return the row that the job returned, a failure if the cluster is lost, or None if the job may be retried."""
    if future.status == "finished":
        return future.result()
    return None if future.status == "error" else make_row(job, Status.FAILED, error=CLUSTER_LOST)


def _reason(future: Future[Row]) -> str:
    from distributed.scheduler import KilledWorker

    error = future.exception()
    return WORKER_DIED if isinstance(error, KilledWorker) else f"{type(error).__name__}: {error}"
