"""Live runs on an emulated robot, in processes that can be killed or slowed down, and what must remain of them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import SlamError
from drivers.messages import Odometry, end_stamp
from drivers.recordings.mcap import McapReader
from slam.io.output_dir import SUMMARY
from slam.io.sessions import read_session

SAVE_PERIOD = 3.0
"""Seconds between two saves of the map, instead of 45, so that short runs have several."""
SAVE_DURATION = 12.0
"""Seconds by which mapping and saving may be late on a busy computer: with the usual period, less than a minute is
missing then.
"""
LAST_SECOND = 1.0
"""Seconds at the end of a recording that may be missing."""
LONGEST_HOLE = 0.2
"""Seconds between two odometry readings of a recording."""
START_TIMEOUT, END_TIMEOUT = 200.0, 150.0
"""Seconds that a run may take to start, with the compilation after a change, and to end."""
BEGUN = 20_000
"""Bytes of a recording that has begun."""
PROGRAM = "from slam.cli import main; main()"
SHORT_PERIOD = f"import slam.cli.autosave as save; save.PERIOD = {SAVE_PERIOD}; save.LARGEST_SHARE = 1.0; "
"""Also if a save takes a second, which is much of such a period but little of the usual one."""

WHEELS = "wheel_radius=0.0318309886&ticks=1000&track=0.3"
"""Options of the emulated bases whose dimensions no program knows: 0.2 mm per count."""
BASE_OPTIONS = {"create2": "", "kobuki": "", "arduino": f"?{WHEELS}", "wheels": f"?{WHEELS}"}


@contextmanager
def emulated(
    folder: Path, world: str, *options: str, lidar: str = "rplidar-s1", base: str = "create2"
) -> Iterator[list[str]]:
    """Run `wclm emulate`; yield the options of `wclm live` for its devices. The files are in `folder`."""
    files = ["--ports", folder / "robot", "--truth", folder / "truth.tum", "--report", folder / "report.json"]
    command = [sys.executable, "-c", PROGRAM, "emulate", world, *map(str, files), "--lidar", lidar, "--base", base]
    process = subprocess.Popen([*command, *options], stdout=subprocess.DEVNULL)
    try:
        wait_for(lambda: (folder / "robot" / "base").is_symlink(), START_TIMEOUT)
        kind = lidar.partition("-")[0]
        yield [
            *("--lidar", f"{kind}:{folder}/robot/lidar?mount=0.1,0,0"),
            *("--base", f"{base}:{folder}/robot/base{BASE_OPTIONS[base]}"),
        ]
    finally:
        process.terminate()
        process.wait()


class LiveRun:
    """`wclm live` with a recording, in the directory `folder`: map, drive.mcap, stdout and stderr."""

    def __init__(self, folder: Path, devices: list[str], *options: str, period: bool = True) -> None:
        self.folder, self.map, self.recording = folder, folder / "map", folder / "drive.mcap"
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-c", (SHORT_PERIOD if period else "") + PROGRAM, "live", *devices, "--no-serve"]
        command += ["--out", str(self.map), "--record", str(self.recording), *options]
        with (folder / "stdout").open("w") as stdout, (folder / "stderr").open("w") as stderr:
            self.process = subprocess.Popen(command, stdout=stdout, stderr=stderr, start_new_session=True)

    @property
    def stderr(self) -> str:
        """What the run has printed."""
        return (self.folder / "stderr").read_text()

    def wait_for_recording(self) -> None:
        """Wait until the recording has begun or the run has ended."""
        path = self.recording
        wait_for(
            lambda: self.process.poll() is not None or (path.exists() and path.stat().st_size > BEGUN), START_TIMEOUT
        )

    def processes(self) -> list[int]:
        """Return the ids of the run's processes, its own first."""
        return process_tree(self.process.pid)


def process_tree(process: int) -> list[int]:
    """Return the ids of a process and of all that it started."""
    found = [process]
    with suppress(OSError):
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in (task / "children").read_text().split():
                found += process_tree(int(child))
    return found


def send(processes: list[int], number: signal.Signals) -> None:
    """Send a signal to processes, some of which may have ended."""
    for process in processes:
        with suppress(ProcessLookupError):
            os.kill(process, number)


def wait_for(condition: Any, timeout: float) -> bool:
    """Wait until a condition is true, `timeout` seconds at most; return whether it is."""
    end = time.monotonic() + timeout
    while not (true := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return bool(true)


@dataclass
class Findings:
    """Figures of one run, and what is wrong with it."""

    figures: dict[str, Any] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    def check_recording(self, path: Path, end: float, slack: float = LAST_SECOND) -> None:
        """Check that a recording has no hole and reaches to `end` (seconds since 1970), up to `slack` seconds."""
        if not path.exists():
            return
        try:
            messages = list(McapReader(path))
        except SlamError as error:
            self.figures["recording"] = str(error)
            if path.stat().st_size > BEGUN:  # else nothing was measured before the end
                self.failures.append(str(error))
            return
        stamps = np.array([message.stamp for message in messages if isinstance(message, Odometry)])
        missing = end - max(map(end_stamp, messages))
        hole = float(np.diff(stamps).max(initial=0.0))
        self.figures |= {"recorded": round(end - missing - messages[0].stamp, 1), "missing": round(missing, 2)}
        if missing > slack:
            self.failures.append(f"the recording ends {missing:.2f} s early")
        if hole > LONGEST_HOLE:
            self.failures.append(f"the recording has a hole of {hole:.2f} s")

    def check_map(self, out: Path, end: float, age: float = SAVE_PERIOD + SAVE_DURATION) -> bool:
        """Check that a saved map can be read and is at most `age` seconds older than `end`; return if it exists."""
        if not out.exists():
            if self.figures.get("recorded", 0.0) > age + SAVE_DURATION:
                self.failures.append("there is no map")
            return False
        summary = json.loads((out / SUMMARY).read_text())
        found = end - read_session(out).latest
        self.figures |= {"map": round(found, 1), "walls": summary["walls"], "drives": len(summary["recordings"])}
        if found > age:
            self.failures.append(f"the map is {found:.1f} s old")
        return True

    def check_recovery(self, out: Path) -> None:
        """Check that `wclm recover` completes what is there and leaves nothing else behind."""
        ended = subprocess.run(
            [sys.executable, "-c", PROGRAM, "recover", str(out)], capture_output=True, text=True, timeout=END_TIMEOUT
        )
        if ended.returncode not in (0, 2) or "Traceback" in ended.stderr:
            self.failures.append(f"wclm recover: {ended.stderr[-300:]}")
        if left := [path.name for path in out.parent.iterdir() if path.name.startswith(f".{out.name}")]:
            self.failures.append(f"left behind: {', '.join(left)}")

    def check_ended(self, processes: list[int]) -> None:
        """Check that processes end by themselves; kill those that do not."""
        if not wait_for(lambda: not list(filter(_runs, processes)), 10.0):
            remaining = list(filter(_runs, processes))
            self.failures.append(f"{len(remaining)} processes remain")
            send(remaining, signal.SIGKILL)


def _runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
