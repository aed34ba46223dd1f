"""An emulated robot and a live run on it, each in a process of its own."""

from __future__ import annotations

import json
import math
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

WCLM = [sys.executable, "-W", "error", "-c", "from slam.cli import main; main()"]
MOUNT = "0.1,0,0"
"""Mount of the emulated lidar: x, y, heading."""
SLOW_LIDAR = ("--lidar", "rplidar-a1")
"""Options of an emulated robot that takes half of the processor time, for tests in which its lidar does not matter."""
COMPILATION_TIMEOUT = 200.0
"""Seconds that the first start after a change may take, with compilation."""


class Robot:
    """Context that runs `wclm emulate` in a directory.

    truth  file with the true trajectory
    specs  options of `wclm live` for its devices
    """

    def __init__(self, folder: Path, world: str = "office", *options: str) -> None:
        self.truth, self._report = folder / "truth.tum", folder / "report.json"
        self._ports = folder / "robot"
        files = ["--ports", str(self._ports), "--truth", str(self.truth), "--report", str(self._report)]
        self._process = subprocess.Popen([*WCLM, "emulate", world, *files, *options], stdout=subprocess.DEVNULL)
        self.specs = [
            "--lidar",
            f"rplidar:{self._ports / 'lidar'}?mount={MOUNT}",
            "--base",
            f"create2:{self._ports / 'base'}",
        ]

    def __enter__(self) -> Self:
        wait_for(lambda: (self._ports / "base").is_symlink(), self._process)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> dict[str, Any]:
        """End the emulator if it still runs; return its report."""
        self._process.terminate()
        self._process.wait(120.0)
        report: dict[str, Any] = json.loads(self._report.read_text())
        return report


class LiveRun:
    """`wclm live` on an emulated robot.

    out          output directory
    cpu_seconds  CPU time of all its processes, once it has ended
    """

    def __init__(self, robot: Robot, out: Path, *options: str, **how: Any) -> None:
        self.out = out
        self.cpu_seconds = math.nan
        self._stdout, self._stderr = out.with_name("stdout"), out.with_name("stderr")
        self._before = children_cpu_seconds()
        with self._stdout.open("w") as stdout, self._stderr.open("w") as stderr:
            command = [*WCLM, "live", *robot.specs, "--out", str(out), *options]
            self.process = subprocess.Popen(command, stdout=stdout, stderr=stderr, **how)

    def line(self, beginning: str) -> str:
        """Wait for a line on stderr with this beginning; return the rest of it."""

        def found() -> list[str]:
            lines = self._stderr.read_text().splitlines()
            return [line.removeprefix(beginning) for line in lines if line.startswith(beginning)]

        wait_for(found, self.process)
        return found()[0]

    def end(self, how: signal.Signals = signal.SIGINT, timeout: float = 120.0) -> tuple[int, str, str]:
        """Send a signal and wait; return exit status, stdout and stderr."""
        self.process.send_signal(how)
        return self.wait(timeout)

    def wait(self, timeout: float = 120.0) -> tuple[int, str, str]:
        """Wait until it ends; return exit status, stdout and stderr. If it does not end, it is killed."""
        try:
            status = self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        self.cpu_seconds = children_cpu_seconds() - self._before
        return status, self._stdout.read_text(), self._stderr.read_text()

    @property
    def summary(self) -> dict[str, Any]:
        """Content of summary.json."""
        summary: dict[str, Any] = json.loads((self.out / "summary.json").read_text())
        return summary

    def counters(self, device: int) -> dict[str, int]:
        """Return the counters of the lidar (0) or the base (1)."""
        counters: dict[str, int] = self.summary["devices"][device]["counters"]
        return counters


def children_cpu_seconds() -> float:
    """Return the CPU time of all children that have ended, and of their children, seconds."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def wait_for(condition: Any, process: subprocess.Popen[Any], timeout: float = COMPILATION_TIMEOUT) -> None:
    """Wait until the condition is true. Fails if the process ends before, or after the timeout."""
    end = time.monotonic() + timeout
    while not condition():
        assert process.poll() is None, f"the process ended: {process.returncode}"
        assert time.monotonic() < end, f"no result after {timeout:g} s"
        time.sleep(0.05)
