"""Recording of measurements to a file, with the status of the devices, in a thread of the reading process.

So a recording has no hole while the program that uses the measurements is busy, stopped or killed.
"""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from threading import Condition, Thread

from ..errors import RecordingError
from ..messages import Message, Scan, end_stamp
from ..recordings.mcap import McapWriter
from ..recordings.ros_encoder import Diagnostic
from .snapshot import RecordingStatus, Snapshot
from .supervisor import DeviceState

DIAGNOSTICS_PERIOD = 1.0
"""Seconds."""
CAPACITY = 20_000
"""Messages that wait for the disk: four minutes of a lidar and a wheel base, about 60 MB."""


class Recorder:
    """Writer of an acquisition's messages and, once a second, of the status of its devices.

    Replaces the file if it exists. Raises RecordingError if it cannot be created; later errors end the recording and
    are in `status`.
    """

    def __init__(self, path: Path) -> None:
        self._writer = McapWriter(path, overwrite=True)
        self._scans = self._odometry = 0
        self._first: float | None = None
        self._last = float("-inf")
        self._problem = ""
        self._diagnostics_due = 0.0
        self._items: deque[Message | Snapshot] = deque()
        self._closed = False
        self._changed = Condition()
        self._thread = Thread(target=self._run, name="recorder")
        self._thread.start()

    @property
    def status(self) -> RecordingStatus:
        """Status of the recording."""
        duration = 0.0 if self._first is None else self._last - self._first
        return RecordingStatus(self._scans, self._odometry, duration, self._problem)

    def put(self, message: Message) -> None:
        """Queue a message."""
        self._put(message)

    def put_snapshot(self, snapshot: Snapshot, *, last: bool = False) -> None:
        """Queue the status of the devices if DIAGNOSTICS_PERIOD has passed, or at the end."""
        if last or time.monotonic() >= self._diagnostics_due:
            self._diagnostics_due = time.monotonic() + DIAGNOSTICS_PERIOD
            self._put(snapshot)

    def close(self) -> None:
        """Write what is queued and finish the file; further calls have no effect."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _put(self, item: Message | Snapshot) -> None:
        with self._changed:
            if self._problem:
                return
            if len(self._items) >= CAPACITY:
                self._problem = "cannot be written: the disk accepts no data"
                return
            self._items.append(item)
            self._changed.notify()

    def _run(self) -> None:
        try:
            while (item := self._next()) is not None:
                self._write(item)
            self._writer.close()
        except RecordingError as error:
            self._problem = error.reason

    def _next(self) -> Message | Snapshot | None:
        with self._changed:
            while not (self._items or self._closed or self._problem):
                self._changed.wait()
            return self._items.popleft() if self._items else None

    def _write(self, item: Message | Snapshot) -> None:
        if isinstance(item, Snapshot):
            if self._first is not None:
                self._writer.write_diagnostics(self._last, make_diagnostics(item))
            return
        self._writer.write(item)
        self._scans += isinstance(item, Scan)
        self._odometry += not isinstance(item, Scan)
        self._first = item.stamp if self._first is None else self._first
        self._last = max(end_stamp(item), self._last)


def make_diagnostics(snapshot: Snapshot) -> list[Diagnostic]:
    """Convert the status of the devices and the acquisition to diagnostics messages."""
    devices = [
        Diagnostic(device.spec, device.state is DeviceState.LOST, device.problem or device.state.value, device.counters)
        for device in snapshot.devices
    ]
    losses = {"dropped": snapshot.dropped, "late": snapshot.late}
    return [*devices, Diagnostic("acquisition", snapshot.dropped > 0, "", losses)]
