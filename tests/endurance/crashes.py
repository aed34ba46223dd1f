"""Ends of a live run that no program survives: kill -9, power failure, full disk."""

from __future__ import annotations

import ctypes
import fcntl
import os
import random
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from .live_run import END_TIMEOUT, Findings, LiveRun, emulated, send

CHAIN = 6
"""Runs that continue each other's maps before a new map begins."""
DISK_SIZE = 600
"""Megabytes of the disk whose power fails."""
SHUTDOWN, WITHOUT_JOURNAL = 0x8004587D, 2
"""EXT4_IOC_SHUTDOWN, EXT4_GOING_FLAGS_NOLOGFLUSH: what was not written to the disk is lost, as if power had failed."""


def kill_runs(folder: Path, runs: int, source: random.Random) -> Iterator[Findings]:
    """Kill live runs at random moments: half of them only the command, half with all its processes."""
    with emulated(folder, "office") as devices:
        previous: Path | None = None
        for number in range(runs):
            found, previous = Findings(), previous if number % CHAIN else None
            run = LiveRun(folder / f"run{number}", devices, *(["--continue", str(previous)] if previous else []))
            if source.random() < 0.85:  # else also while it starts
                run.wait_for_recording()
            time.sleep(source.uniform(0.3, 18.0))
            if run.process.poll() is not None:
                found.failures.append(f"ended with {run.process.returncode}: {run.stderr[-300:]}")
            processes, alone = run.processes(), source.random() < 0.5
            end = time.time()
            send(processes[:1] if alone else processes, signal.SIGKILL)
            run.process.wait()
            previous = _check(found, run, processes, end, previous) or previous
            yield found


def power_failures(folder: Path, runs: int, source: random.Random) -> Iterator[Findings]:
    """Cut the power of the disk on which map and recording are. Needs root, for a file system of its own."""
    with emulated(folder, "office") as devices, Disk(folder) as disk:
        previous: Path | None = None
        for number in range(runs):
            found, previous = Findings(), previous if number % CHAIN else None
            if not number % CHAIN:
                disk.clear()
            run = LiveRun(disk.place / f"run{number}", devices, *(["--continue", str(previous)] if previous else []))
            run.wait_for_recording()
            time.sleep(source.uniform(0.5, 14.0))
            processes, end = run.processes(), time.time()
            if source.random() < 0.3:  # at once after the regular end
                run.process.send_signal(signal.SIGTERM)
                if status := run.process.wait(END_TIMEOUT):
                    found.failures.append(f"ended with {status}: {run.stderr[-300:]}")
            disk.fail()
            send(processes, signal.SIGKILL)
            run.process.wait()
            found.check_ended(processes[1:])
            disk.repair()
            previous = _check(found, run, [], end, previous, slack=1.5) or previous
            yield found


def full_disks(folder: Path, runs: int, source: random.Random) -> Iterator[Findings]:
    """Fill the disk on which map and recording are. Needs root, for a file system of its own."""
    with emulated(folder, "office") as devices:
        for number in range(runs):
            found, place = Findings(), folder / f"disk{number}"
            place.mkdir()
            size = f"size={source.randint(18, 30)}m"
            subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", place], check=True)
            try:
                _fill(found, LiveRun(place / "run", devices), place, source)
            finally:
                subprocess.run(["umount", place], check=True)
            yield found


def _fill(found: Findings, run: LiveRun, place: Path, source: random.Random) -> None:
    """Let another program fill the disk while the run goes on; then end or kill the run."""
    run.wait_for_recording()
    time.sleep(source.uniform(1.0, 10.0))
    filled = time.time()
    with suppress(OSError), (place / "other").open("wb", buffering=0) as file:
        while file.write(bytes(1 << 16)):
            pass
    time.sleep(source.uniform(4.0, 12.0))
    how = source.choice([signal.SIGTERM, signal.SIGTERM, signal.SIGKILL])
    processes, end = run.processes(), time.time()
    run.process.send_signal(how)
    found.figures["status"] = run.process.wait(END_TIMEOUT)
    found.check_ended(processes[1:])
    elsewhere = re.findall(r"the results are in (\S+) instead", run.stderr)
    found.figures["elsewhere"] = len(elsewhere)
    found.check_recording(run.recording, filled, slack=1.5)
    killed = how == signal.SIGKILL
    if not found.check_map(Path(elsewhere[0]) if elsewhere else run.map, end, end if killed else 3.0):
        found.failures.append("there is no map")
    if "Traceback" in run.stderr:
        found.failures.append(run.stderr[-500:])


def _check(
    found: Findings, run: LiveRun, processes: list[int], end: float, previous: Path | None, slack: float = 1.0
) -> Path | None:
    """Check what is left of a run that ended at `end`; return its map if there is one."""
    found.check_ended(processes[1:])
    found.check_recording(run.recording, end, slack)
    exists = found.check_map(run.map, end)
    found.check_recovery(run.map)
    if exists and previous is not None and found.figures["drives"] < 2:
        found.failures.append("the earlier map was not continued")
    if "Traceback" in run.stderr:
        found.failures.append(run.stderr[-500:])
    return run.map if exists else None


class Disk:
    """Context with a file system in a file, whose power can fail; `place` is where it is mounted."""

    def __init__(self, folder: Path) -> None:
        self._image, self.place = folder / "disk.img", folder / "disk"
        self.place.mkdir()

    def __enter__(self) -> Disk:
        self._make()
        return self

    def __exit__(self, *_: object) -> None:
        self._unmount()

    def clear(self) -> None:
        """Begin with an empty disk."""
        self._unmount()
        self._make()

    def fail(self) -> None:
        """Cut the power."""
        directory = os.open(self.place, os.O_RDONLY)
        fcntl.ioctl(directory, SHUTDOWN, ctypes.c_uint32(WITHOUT_JOURNAL))
        os.close(directory)

    def repair(self) -> None:
        """Mount the disk again, as after a restart of the computer."""
        time.sleep(0.3)
        self._unmount()
        self._mount()

    def _make(self) -> None:
        with self._image.open("wb") as file:
            file.truncate(DISK_SIZE << 20)
        subprocess.run(["mkfs.ext4", "-q", "-F", self._image], check=True)
        self._mount()

    def _mount(self) -> None:
        subprocess.run(["mount", "-o", "loop", self._image, self.place], check=True)

    def _unmount(self) -> None:
        subprocess.run(["umount", self.place], check=True)
