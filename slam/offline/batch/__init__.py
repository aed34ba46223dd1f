"""Map many recordings in parallel with the workers of a Dask cluster, each into a directory of its own.

How a recording is mapped is a function that the caller provides. This package names the directories, skips what is
complete, assigns recordings to workers, retries after crashes, and records the outcome of each. Dask is imported by
this package only, when a cluster is used: it belongs to the extra "batch".
"""

from .jobs import Job, JobOptions, fingerprint, make_jobs, read_completed_summary, remove_leftovers
from .table import Row, Status, make_row, write_table

__all__ = [
    "Job",
    "JobOptions",
    "Row",
    "Status",
    "fingerprint",
    "make_jobs",
    "make_row",
    "read_completed_summary",
    "remove_leftovers",
    "write_table",
]
