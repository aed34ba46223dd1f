"""File with the state of a live run, for programs that watch it on a robot without a display."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OutputError
from ..events import Event, KeyframeAdded, LoopDecided, ModeChanged, Notice, ScanTracked, StateChanged
from ..io.disk_reserve import free_space
from ..io.host import resident_memory
from ..io.json_files import to_json_types
from ..io.output_dir import SUMMARY
from .console import print_message
from .device_monitor import format_faults

if TYPE_CHECKING:
    from drivers.devices.snapshot import Snapshot

STATUS_PERIOD = 1.0
"""Seconds between two updates of the file."""


class StatusFile:
    """Sink that writes a JSON file once a second; a reader always finds a complete one.

    The file is not forced to the disk, so that it does not wear out a memory card.

    path  of the file; its directory must exist
    out   output directory of the run, on whose disk free space is measured

    Raises OutputError if the file cannot be written at the beginning. Later errors are printed once.
    """

    handled = (ScanTracked, KeyframeAdded, StateChanged, ModeChanged, LoopDecided, Notice)

    def __init__(self, path: Path, out: Path) -> None:
        if path.is_dir():
            raise OutputError(f"{path}: is a directory, and the file with the status must be named")
        self._path, self._out = path, out.resolve()
        self._started, self._written, self._problem = time.monotonic(), float("-inf"), ""
        self._values: dict[str, Any] = {
            "state": "OK", "frozen": False, "scans": 0, "pose": None, "map": {}, "notice": "",
        }  # fmt: skip
        self._loops: Counter[str] = Counter()
        self._scanned: float | None = None
        self._clock_offset = 0.0  # from the steady clock to the stamps; the wall clock may be set during the run
        self._devices: dict[str, Any] = {"devices": [], "dropped": 0, "recording": None}
        try:
            self._write(running=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error

    def handle(self, event: Event) -> None:
        """Process one event."""
        match event:
            case ScanTracked():
                self._values["scans"] += 1
                self._values["pose"], self._scanned = event.pose, event.stamp
            case KeyframeAdded():
                self._values["map"] = dict(event.counts)
            case StateChanged():
                self._values["state"] = event.state
            case ModeChanged():
                self._values["frozen"] = event.frozen
            case LoopDecided():
                self._loops[str(event.status)] += 1
            case Notice() if event.level != "TRACE":
                self._values["notice"] = event.text

    def show(self, snapshot: Snapshot) -> None:
        """Write the state of run and devices, once per STATUS_PERIOD; cheap otherwise."""
        if time.monotonic() < self._written + STATUS_PERIOD:
            return
        self._take(snapshot)
        self._try_to_write(running=True)

    def close(self, snapshot: Snapshot, failure: str = "") -> None:
        """Write that the devices are not read any more, and the error that ended this, if any."""
        self._take(snapshot)
        self._values["failure"] = failure
        self._try_to_write(running=False)

    def finish(self) -> None:
        """Write the final numbers after the map was saved: scans that waited for odometry are mapped at the end."""
        self._try_to_write(running=False)

    def _take(self, snapshot: Snapshot) -> None:
        devices = [
            {"spec": one.spec, "state": one.state.value, "problem": one.problem, "faults": format_faults(one.counters)}
            for one in snapshot.devices
        ]
        recording = snapshot.recording and {
            "seconds": snapshot.recording.duration,
            "problem": snapshot.recording.problem,
        }
        self._clock_offset = snapshot.clock_offset
        self._devices = {"devices": devices, "dropped": snapshot.dropped, "recording": recording}

    def _try_to_write(self, *, running: bool) -> None:
        try:
            self._write(running=running)
            self._problem = ""
        except OSError as error:
            if not self._problem:
                print_message(f"{self._path}: {error.strerror or error}; the run goes on")
            self._problem = str(error)

    def _write(self, *, running: bool) -> None:
        self._written = now = time.monotonic()
        content = {
            "time": time.time(),
            "running": running,
            "seconds": now - self._started,
            **self._values,
            "delay": None if self._scanned is None else now + self._clock_offset - self._scanned,
            "loops": dict(self._loops),
            **self._devices,
            "saved": _modified(self._out / SUMMARY),
            "free_disk": _free_mebibytes(self._out),
            "memory": resident_memory(),
        }
        work = self._path.with_name(f".{self._path.name}.new")
        work.write_text(json.dumps(to_json_types(content), indent=2) + "\n", encoding="utf-8")
        work.replace(self._path)


def _modified(path: Path) -> float | None:
    """Return when a file was written, seconds since 1970; None if it does not exist."""
    try:
        return path.stat().st_mtime
    except OSError:
        return None


def _free_mebibytes(path: Path) -> float | None:
    """Return the free MiB on the disk of a directory that may not exist yet; None if that is not known."""
    try:
        return free_space(next(folder for folder in (path, *path.parents) if folder.is_dir())) / (1 << 20)
    except (OSError, StopIteration):
        return None
