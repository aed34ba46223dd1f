"""What a result was had on: versions, the machine, and the memory that the process took."""

from __future__ import annotations

import os
import platform
import resource
import sys
from contextlib import suppress
from importlib import metadata
from pathlib import Path

PACKAGES = ("wclm-slam", "numpy", "numba", "gtsam", "rerun-sdk")
CPU_LIST = Path("/proc/cpuinfo")
"""Where Linux tells the processor's name, which Python does not ask for."""
MEMORY_STATUS = Path("/proc/self/status")
"""Where Linux tells the memory of this program alone; what getrusage tells includes the one that started it."""


def versions() -> dict[str, str]:
    """Versions of this program and of what its results depend on."""
    return {name: metadata.version(name) for name in PACKAGES} | {"python": platform.python_version()}


def machine() -> dict[str, str | int]:
    """What the times were taken on."""
    model = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = CPU_LIST.read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    return {"processor": model, "cores": os.cpu_count() or 1, "system": platform.system()}


def peak_memory() -> float:
    """The most memory this process has had, MiB."""
    with suppress(OSError, StopIteration):
        lines = MEMORY_STATUS.read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / (1 << 10)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)
