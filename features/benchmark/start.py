"""Time and memory of starting: the first start, which compiles, later starts, and without the compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

TIMED = """
import json, sys, time
from pathlib import Path
start = time.process_time()
import numpy as np
numpy_only = time.process_time()
before = status()
from features import warm_up
from features.benchmark.timing import measure, scans_of
imported = time.process_time()
warm_up()
ready = time.process_time()
angles, ranges = scans_of(920, int(sys.argv[1]), 0)
row = measure("split", "wclm-ml", ranges, angles, int(sys.argv[2]))
print(json.dumps([imported - numpy_only, ready - imported, row.best_us, before, status()]))
"""
"""Program of a separate interpreter; its arguments are the numbers of scans and of rounds."""

STATUS = """
def status():
    try:
        pages = int(open("/proc/self/statm").read().split()[1])
    except OSError:
        return float("nan")
    import resource
    return pages * resource.getpagesize() / 1e6
"""
"""Memory of a process in megabytes; NaN if the system does not provide it."""


class Start(NamedTuple):
    """Measurements of one process.

    import_s      CPU seconds to import the package, after numpy
    first_scan_s  CPU seconds until the first scan is done: compilation, or loading from the cache
    scan_us       microseconds of a later scan of 920 beams (median over scans of the fastest call)
    numpy_mb, memory_mb  megabytes of the process before the package was imported, and at its end
    """

    name: str
    import_s: float
    first_scan_s: float
    scan_us: float
    numpy_mb: float
    memory_mb: float


def measure_starts() -> list[Start]:
    """Measure a first start with an empty cache, a second one, and one with the compiler switched off."""
    with tempfile.TemporaryDirectory() as cache:
        cached = {"NUMBA_CACHE_DIR": cache}
        return [
            start_once("first start", cached, 20, 20),
            start_once("later starts", cached, 20, 20),
            start_once("without numba's compiler", {"NUMBA_DISABLE_JIT": "1"}, 3, 3),
        ]


def start_once(name: str, environment: dict[str, str], scans: int, rounds: int) -> Start:
    """Run the measurement in a new interpreter, with additional environment variables."""
    root = str(Path(__file__).parents[2])
    path = os.pathsep.join(part for part in (root, os.environ.get("PYTHONPATH")) if part)
    result = subprocess.run(
        [sys.executable, "-c", STATUS + TIMED, str(scans), str(rounds)],
        env={**os.environ, "PYTHONPATH": path, **environment},
        capture_output=True,
        check=True,
        text=True,
    )
    return Start(name, *json.loads(result.stdout))
