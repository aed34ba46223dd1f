"""Recording of measurements to a file, with the status of the devices."""

from __future__ import annotations

import time

from ..messages import Message, Scan, end_stamp
from ..recordings.mcap import McapWriter
from ..recordings.ros_encoder import Diagnostic
from .acquisition import Snapshot
from .supervisor import DeviceState

DIAGNOSTICS_PERIOD = 1.0
"""Seconds."""


class Recorder:
    """Writer of an acquisition's messages and, once a second, of the status of its devices.

    scans, odometry  numbers of written messages

    Methods raise RecordingError if the disk is full.
    """

    def __init__(self, writer: McapWriter) -> None:
        self.scans = self.odometry = 0
        self._writer = writer
        self._first: float | None = None
        self._last = float("-inf")
        self._diagnostics_written = float("-inf")

    @property
    def duration(self) -> float:
        """Seconds from the first to the last measurement."""
        return 0.0 if self._first is None else self._last - self._first

    def write(self, message: Message) -> None:
        """Append a message."""
        self._writer.write(message)
        self.scans += isinstance(message, Scan)
        self.odometry += not isinstance(message, Scan)
        self._first = message.stamp if self._first is None else self._first
        self._last = max(end_stamp(message), self._last)

    def write_diagnostics_if_due(self, snapshot: Snapshot) -> None:
        """Append the status of the devices if DIAGNOSTICS_PERIOD has passed; cheap otherwise."""
        if time.monotonic() >= self._diagnostics_written + DIAGNOSTICS_PERIOD:
            self.write_diagnostics(snapshot)

    def write_diagnostics(self, snapshot: Snapshot) -> None:
        """Append the status of the devices, unless nothing has been measured yet."""
        if self._first is not None:
            self._diagnostics_written = time.monotonic()
            self._writer.write_diagnostics(self._last, make_diagnostics(snapshot))


def make_diagnostics(snapshot: Snapshot) -> list[Diagnostic]:
    """Convert the status of the devices and the acquisition to diagnostics messages."""
    devices = [
        Diagnostic(device.spec, device.state is DeviceState.LOST, device.problem or device.state.value, device.counters)
        for device in snapshot.devices
    ]
    losses = {"dropped": snapshot.dropped, "late": snapshot.late}
    return [*devices, Diagnostic("acquisition", snapshot.dropped > 0, "", losses)]
