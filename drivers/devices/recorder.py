"""What devices measure into a file, with how they were doing."""

from __future__ import annotations

import time

from ..messages import Message, Scan, end_stamp
from ..recordings.mcap import McapWriter
from ..recordings.ros_messages import Diagnostic
from .acquisition import Snapshot
from .supervisor import DeviceState

DIAGNOSTICS_PERIOD = 1.0
"""Seconds."""


class Recorder:
    """Writes the messages of an acquisition, and once a second how its devices are doing.

    scans, odometry  how many were written

    Methods raise RecordingError where the disk is full.
    """

    def __init__(self, writer: McapWriter) -> None:
        self.scans = self.odometry = 0
        self._writer = writer
        self._first: float | None = None
        self._last = float("-inf")
        self._diagnostics_written = float("-inf")

    @property
    def duration(self) -> float:
        """Seconds from the first to the last that was measured."""
        return 0.0 if self._first is None else self._last - self._first

    def write(self, message: Message) -> None:
        """Append a message."""
        self._writer.write(message)
        self.scans += isinstance(message, Scan)
        self.odometry += not isinstance(message, Scan)
        self._first = message.stamp if self._first is None else self._first
        self._last = max(end_stamp(message), self._last)

    def write_diagnostics_if_due(self, snapshot: Snapshot) -> None:
        """Append how the devices are doing, if it is time to; cheap otherwise."""
        if time.monotonic() >= self._diagnostics_written + DIAGNOSTICS_PERIOD:
            self.write_diagnostics(snapshot)

    def write_diagnostics(self, snapshot: Snapshot) -> None:
        """Append how the devices are doing, once anything was measured."""
        if self._first is not None:
            self._diagnostics_written = time.monotonic()
            self._writer.write_diagnostics(self._last, make_diagnostics(snapshot))


def make_diagnostics(snapshot: Snapshot) -> list[Diagnostic]:
    """How the devices and the acquisition are doing, as it is recorded."""
    devices = [
        Diagnostic(device.spec, device.state is DeviceState.LOST, device.problem or device.state.value, device.counters)
        for device in snapshot.devices
    ]
    losses = {"dropped": snapshot.dropped, "late": snapshot.late}
    return [*devices, Diagnostic("acquisition", snapshot.dropped > 0, "", losses)]
