"""Status of an acquisition: of its devices, its losses and its recording."""

from __future__ import annotations

from dataclasses import dataclass

from .supervisor import DeviceStatus


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    """Status of the recording of an acquisition.

    scans, odometry  numbers of written messages
    duration         seconds from the first to the last of them
    problem          why the recording ended early; empty if it did not
    """

    scans: int = 0
    odometry: int = 0
    duration: float = 0.0
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Status of the acquisition.

    devices    status of each device, in the order of the specs
    dropped    messages dropped for lack of room because the consumer was slow; they are in the recording
    late       messages discarded because later ones had been delivered before they arrived
    recording  status of the recording; None if there is none
    clock_offset  seconds from the steady clock to the stamps, as the wall clock was set at the start
    """

    devices: tuple[DeviceStatus, ...] = ()
    dropped: int = 0
    late: int = 0
    recording: RecordingStatus | None = None
    clock_offset: float = 0.0

    @property
    def all_have_run(self) -> bool:
        """True if every device has measured anything so far."""
        return bool(self.devices) and all(status.has_run for status in self.devices)
