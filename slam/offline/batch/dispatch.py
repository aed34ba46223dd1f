"""Giving jobs to workers, one at a time each, and taking what came of them as it comes."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from uuid import uuid4

from distributed import Client, Future, wait
from distributed.scheduler import KilledWorker

from .jobs import Job
from .table import Row, Status, row_of

LOOK = 0.5  # seconds between two looks for workers that are new, or come back
GONE = "the cluster is gone"

Work = Callable[[Job], Row]
"""What a worker does with a job. What is wrong with the recording is in the row; what it raises is tried again."""


def dispatch(jobs: Sequence[Job], work: Work, client: Client, retries: int) -> Iterator[Row]:
    """The rows of jobs: one of each when a worker takes it (RUNNING), one when it is over.

    Each job is sent to a worker that has no other: so it is known which job killed its worker, and none is blamed for
    having waited for its turn there. It is tried again after the others then, and where `work` raises; `retries` times.
    """
    waiting, tries = deque(jobs), Counter[str]()
    running: dict[Future[Row], tuple[Job, str]] = {}
    while waiting or running:
        for worker in _idle(client, {worker for _, worker in running.values()}):
            if waiting:
                job = waiting.popleft()
                tries[job.name] += 1
                key = f"{job.name}-{uuid4().hex}"
                future = client.submit(work, job, key=key, workers=[worker], allow_other_workers=True, pure=False)
                running[future] = job, worker
                yield row_of(job, Status.RUNNING)
        for future in _finished(running):
            job, _ = running.pop(future)
            row = _outcome(job, future)
            if row is None and tries[job.name] <= retries:
                waiting.append(job)
                continue
            yield row or row_of(job, Status.FAILED, error=_reason(future))
        if client.status == "closed":
            yield from (row_of(job, Status.FAILED, error=GONE) for job in waiting)
            return


def _idle(client: Client, busy: set[str]) -> list[str]:
    """Addresses of the workers that there are now without those that are busy."""
    return [worker for worker in client.scheduler_info(n_workers=-1)["workers"] if worker not in busy]


def _finished(running: dict[Future[Row], tuple[Job, str]]) -> list[Future[Row]]:
    """Those that are over; waits a while for the first."""
    if not running:
        time.sleep(LOOK)
        return []
    with suppress(TimeoutError):
        wait(list(running), timeout=LOOK, return_when="FIRST_COMPLETED")
    return [future for future in running if future.done()]


def _outcome(job: Job, future: Future[Row]) -> Row | None:
    """What `work` returned; a failure where the cluster is gone; None where another try may help."""
    if future.status == "finished":
        return future.result()
    return None if future.status == "error" else row_of(job, Status.FAILED, error=GONE)


def _reason(future: Future[Row]) -> str:
    error = future.exception()
    return "the worker dies of it" if isinstance(error, KilledWorker) else f"{type(error).__name__}: {error}"
