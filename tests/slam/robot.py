"""An emulated robot and a live run on it, each a process of its own, as two terminals are."""

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
"""Of the emulated lidar."""
COMPILING = 200.0
"""Seconds that the first start after a change may take."""


class Robot:
    """`wclm emulate` in a directory; it ends when the context is left.

    truth  the file with its true path
    specs  how `wclm live` is told of it
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
        """End it, if it has not ended yet; what it says that happened."""
        self._process.terminate()
        self._process.wait(20.0)
        report: dict[str, Any] = json.loads(self._report.read_text())
        return report


class LiveRun:
    """`wclm live` on a robot.

    out        its directory of results
    processor  seconds of processor time that it took, all its processes; once it has ended
    """

    def __init__(self, robot: Robot, out: Path, *options: str, **how: Any) -> None:
        self.out = out
        self.processor = math.nan
        self._told, self._complained = out.with_name("stdout"), out.with_name("stderr")
        self._before = processor_time()
        with self._told.open("w") as stdout, self._complained.open("w") as stderr:
            command = [*WCLM, "live", *robot.specs, "--out", str(out), *options]
            self.process = subprocess.Popen(command, stdout=stdout, stderr=stderr, **how)

    def line(self, beginning: str) -> str:
        """Wait for a line on stderr that begins like that; the rest of it."""

        def found() -> list[str]:
            lines = self._complained.read_text().splitlines()
            return [line.removeprefix(beginning) for line in lines if line.startswith(beginning)]

        wait_for(found, self.process)
        return found()[0]

    def end(self, how: signal.Signals = signal.SIGINT, patience: float = 60.0) -> tuple[int, str, str]:
        """Tell it to end; status, stdout and stderr."""
        self.process.send_signal(how)
        return self.wait(patience)

    def wait(self, patience: float = 60.0) -> tuple[int, str, str]:
        """Wait until it ends by itself; status, stdout and stderr."""
        status = self.process.wait(patience)
        self.processor = processor_time() - self._before
        return status, self._told.read_text(), self._complained.read_text()

    @property
    def summary(self) -> dict[str, Any]:
        """What it left in summary.json."""
        summary: dict[str, Any] = json.loads((self.out / "summary.json").read_text())
        return summary

    def counters(self, device: int) -> dict[str, int]:
        """Of the lidar (0) or the base (1)."""
        counters: dict[str, int] = self.summary["devices"][device]["counters"]
        return counters


def processor_time() -> float:
    """Seconds of processor time of all children that have ended, and of theirs."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def wait_for(condition: Any, process: subprocess.Popen[Any], patience: float = COMPILING) -> None:
    """Until it holds, as long as the process lives."""
    end = time.monotonic() + patience
    while not condition():
        assert process.poll() is None, f"it ended: {process.returncode}"
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)
