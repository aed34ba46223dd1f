"""Giving jobs to workers, one at a time each, and taking what came of them as it comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from uuid import uuid4

from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker

from .jobs import Job
from .table import Row, Status, row_of

Work = Callable[[Job], Row]
"""What a worker does with a job; what is wrong with the recording is in the row, what it raises is tried again."""


def dispatch(jobs: Sequence[Job], work: Work, client: Client, retries: int) -> Iterator[Row]:
    """The rows of jobs: one of each when a worker takes it (RUNNING), one when it is over (DONE or FAILED).

    No more jobs are under way than there are workers: so a worker that dies takes one with it, and no job is held to
    have killed a worker while it waited for its turn. Where `work` raises it is tried again, `retries` times.
    """
    waiting = deque(jobs)
    running: dict[Future[Row], Job] = {}
    finished = as_completed()

    def start() -> Iterator[Row]:
        while waiting and len(running) < max(1, len(client.scheduler_info(n_workers=-1)["workers"])):
            job = waiting.popleft()
            future = client.submit(work, job, key=f"{job.name}-{uuid4().hex}", retries=retries, pure=False)
            running[future] = job
            finished.add(future)
            yield row_of(job, Status.RUNNING)

    yield from start()
    for future in finished:
        yield _outcome(running.pop(future), future)
        future.release()
        yield from start()


def _outcome(job: Job, future: Future[Row]) -> Row:
    if future.status == "finished":
        return future.result()
    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return row_of(job, Status.FAILED, error=f"the worker died of it, {error.allowed_failures + 1} times")
    reason = "the cluster is gone" if error is None else f"{type(error).__name__}: {error}"
    return row_of(job, Status.FAILED, error=reason)
