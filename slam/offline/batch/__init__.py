"""Many recordings, each mapped into a directory of its own, by the processes of a Dask cluster.

What is done with one recording is for the caller to say; here is in which directory, by which worker, whether again,
and what came of it. Dask is imported here and nowhere else.
"""

from .jobs import Job, Request, completed, fingerprint, jobs_for, remove_leftovers
from .table import Row, Status, row_of, write_table

__all__ = [
    "Job",
    "Request",
    "Row",
    "Status",
    "completed",
    "fingerprint",
    "jobs_for",
    "remove_leftovers",
    "row_of",
    "write_table",
]
