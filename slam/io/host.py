"""Describe what a result was computed with: package versions, the machine, and the memory used."""

from __future__ import annotations

import os
import platform
import resource
import sys
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path

PACKAGES = ("wclm-slam", "numpy", "numba", "gtsam", "rerun-sdk")
CPU_INFO = Path("/proc/cpuinfo")
"""Contains the processor's name on Linux, which Python does not provide."""
MEMORY_STATUS = Path("/proc/self/status")
"""Contains the memory of this process alone on Linux; getrusage includes the peak of the parent before exec."""


def versions() -> dict[str, str]:
    """Return the versions of this program, of the packages its results depend on, and of Python."""
    return {name: _installed(name) for name in PACKAGES} | {"python": platform.python_version()}


@cache
def _installed(package: str) -> str:
    """Return the version of a package; a live run needs it at each save."""
    return metadata.version(package)


def describe_machine() -> dict[str, str | int]:
    """Return the processor's name, the number of cores and the operating system."""
    model = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = CPU_INFO.read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    return {"processor": model, "cores": os.cpu_count() or 1, "system": platform.system()}


def peak_memory() -> float:
    """Return the largest memory of this process so far, MiB."""
    if (known := _memory_status("VmHWM:")) is not None:
        return known
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def resident_memory() -> float | None:
    """Return the present memory of this process, MiB; None if the system does not say."""
    return _memory_status("VmRSS:")


def _memory_status(name: str) -> float | None:
    with suppress(OSError, StopIteration):
        lines = MEMORY_STATUS.read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith(name)).split()[1]) / (1 << 10)
    return None
