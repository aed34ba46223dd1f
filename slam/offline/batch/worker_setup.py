"""What a worker of a local cluster starts with: Ctrl-C is for the process that started it, which ends its workers.

A terminal sends it to all of them.
"""

from __future__ import annotations

import signal


def dask_setup(worker: object) -> None:
    """Called by Dask in the worker's process before it takes work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
