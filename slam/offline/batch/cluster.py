"""Workers: those of this computer, started for the purpose, or those of a cluster that is there."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory

import dask
from distributed import Client, LocalCluster

from ...errors import ClusterError

__all__ = ["Client", "local_workers", "workers_of"]

HERE = "127.0.0.1"  # what is sent to workers is code: nobody else may
CONNECTING, STARTING = 10.0, 30.0  # seconds to wait for an existing scheduler and its first worker
CONFIGURATION = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.admin.system-monitor.disk": False,
}


@contextmanager
def local_workers(count: int) -> Iterator[Client]:
    """`count` processes of one thread each, reached from this computer only, without a dashboard.

    Killed ones come back; their task has failed. Leaving the context ends what they are doing, by force after some
    seconds.
    """
    with TemporaryDirectory(prefix="wclm-") as scratch, dask.config.set(CONFIGURATION):
        cluster = LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host=HERE,
            dashboard_address=f"{HERE}:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,  # what matters is in the recordings' logs and in the table
            memory_limit=0,  # of its own a worker near its limit would pause, and nothing it holds could be given back
            local_directory=scratch,
            preload=["slam.offline.batch.worker_setup"],
        )
        try:
            with Client(cluster) as client:
                yield client
        finally:
            cluster.close()


@contextmanager
def workers_of(address: str) -> Iterator[Client]:
    """The workers of the scheduler at `address`, such as "tcp://10.0.0.1:8786".

    Raises ClusterError where there is no scheduler, or no worker comes.
    """
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what matters of it is in the rows
    try:
        client = Client(address, timeout=CONNECTING)
    except (OSError, ValueError) as error:
        raise ClusterError(f"{address}: no Dask scheduler answers there ({_first_line(error)})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=STARTING)
        except TimeoutError as error:
            raise ClusterError(
                f"{address}: the scheduler has no workers; start one with: dask worker {address}"
            ) from error
        yield client


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
