"""Provide workers: start them on this computer, or connect to an existing Dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partialmethod
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from ...errors import ClusterError
from ...extras import require_extra

if TYPE_CHECKING:
    from distributed import Client as Client  # re-exported for annotations: this package alone imports Dask

LOCALHOST = "127.0.0.1"
"""Interface of local workers: they execute any code that is sent to them, so no other computer may reach them; other
users of this one are refused by `private_comm`."""
CONNECTION_TIMEOUT = 10.0
"""Seconds to wait for an existing scheduler."""
WORKER_TIMEOUT = 30.0
"""Seconds to wait for its first worker."""
ENDING_TIMEOUT = 1.0
"""Seconds for a worker to end by itself at the end of a batch. If it still maps a recording, the batch was interrupted:
the recording is mapped again when the batch is continued, so nothing is lost."""
CONFIGURATION = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.admin.system-monitor.disk": False,
}


@contextmanager
def start_local_workers(count: int) -> Iterator[Client]:
    """Start `count` processes of one thread each, reachable from this process and each other only, without a dashboard.

    A killed worker is restarted; its task has failed. Leaving the context ends running tasks, after ENDING_TIMEOUT by
    force. Raises MissingExtraError.
    """
    require_extra("batch")
    import dask
    from distributed import Client, LocalCluster, Nanny

    from .private_comm import PROTOCOL, SECRET_KEY, new_secret, register_protocol

    class ProcessOfWorker(Nanny):
        close = partialmethod(Nanny.close, timeout=ENDING_TIMEOUT)

    register_protocol()
    configuration = CONFIGURATION | {SECRET_KEY: new_secret()}
    with TemporaryDirectory(prefix="wclm-") as scratch, dask.config.set(configuration):
        cluster = LocalCluster(
            protocol=PROTOCOL,
            n_workers=count,
            threads_per_worker=1,
            worker_class=ProcessOfWorker,
            host=LOCALHOST,
            dashboard_address=f"{LOCALHOST}:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,  # errors are in the logs of the recordings and in the table
            memory_limit=0,  # near a limit a worker would pause, although it holds no data that it could release
            local_directory=scratch,
            preload=["slam.offline.batch.worker_setup"],
        )
        try:
            with Client(cluster) as client:
                yield client
        finally:
            cluster.close()


@contextmanager
def connect_to_workers(address: str) -> Iterator[Client]:
    """Connect to the scheduler at `address`, such as "tcp://10.0.0.1:8786".

    Raises ClusterError if there is no scheduler or no worker appears, and MissingExtraError.
    """
    require_extra("batch")
    from distributed import Client

    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors are in the table
    try:
        client = Client(address, timeout=CONNECTION_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ClusterError(f"{address}: no Dask scheduler answers there ({_first_line(error)})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT)
        except TimeoutError as error:
            raise ClusterError(
                f"{address}: the scheduler has no workers; start one with: dask worker {address}"
            ) from error
        yield client


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
