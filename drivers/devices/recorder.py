"""Devices to a file, with how they were doing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from ..mcap import McapWriter
from ..messages import Scan, end_of
from ..ros_messages import Diagnostic
from .acquisition import Acquisition, Snapshot
from .session import State

DIAGNOSTICS_PERIOD = 1.0
"""Seconds."""
LOOK_UP = 0.1
"""Seconds without a message after which the recorder looks what else there is to do."""


@dataclass(slots=True)
class Recorded:
    """What was recorded: counts, and the first and the last time (seconds)."""

    scans: int = 0
    odometry: int = 0
    first: float | None = None
    last: float | None = None

    @property
    def duration(self) -> float:
        """Seconds."""
        return 0.0 if self.first is None or self.last is None else self.last - self.first


def record(acquisition: Acquisition, writer: McapWriter, recorded: Recorded, look: Callable[[Snapshot], None]) -> None:
    """Write all messages until the acquisition ends or is stopped, and once a second how the devices are doing.

    recorded  is counted up meanwhile, so that it is right after an error, too
    look      is called several times a second

    Raises RecordingError where the disk is full, DriverError where the acquisition breaks down.
    """
    told = float("-inf")
    while not acquisition.ended:
        message = acquisition.receive(LOOK_UP)
        if message is not None:
            writer.write(message)
            recorded.scans += isinstance(message, Scan)
            recorded.odometry += not isinstance(message, Scan)
            recorded.first = message.stamp if recorded.first is None else recorded.first
            recorded.last = max(end_of(message), recorded.last or 0.0)
        if recorded.last is not None and time.monotonic() >= told + DIAGNOSTICS_PERIOD:
            told = time.monotonic()
            writer.write_diagnostics(recorded.last, diagnostics_of(acquisition.snapshot))
        look(acquisition.snapshot)
    if recorded.last is not None:
        writer.write_diagnostics(recorded.last, diagnostics_of(acquisition.snapshot))


def diagnostics_of(snapshot: Snapshot) -> list[Diagnostic]:
    """How the devices and the acquisition are doing, as it is recorded."""
    devices = [
        Diagnostic(device.spec, device.state is State.LOST, device.problem or device.state.value, device.counters)
        for device in snapshot.devices
    ]
    losses = {"dropped": snapshot.dropped, "late": snapshot.late}
    return [*devices, Diagnostic("acquisition", snapshot.dropped > 0, "", losses)]
