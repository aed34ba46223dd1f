"""Set up a worker of a local cluster (Dask preload module): ignore Ctrl-C, and connect with the secret of the batch.

A terminal sends SIGINT to all processes. Only the process that started the workers handles it, and ends them.
"""

from __future__ import annotations

import signal

from .private_comm import register_protocol

register_protocol()


def dask_setup(worker: object) -> None:
    """Ignore SIGINT; called by Dask in the worker's process before it takes work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
