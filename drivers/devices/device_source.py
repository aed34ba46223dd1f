"""Devices as a `Source`, which can be read once: time does not come back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..errors import DriverError
from ..messages import Message, SourceReport
from .acquisition import Acquisition, Snapshot
from .device_spec import DeviceSpec


class DeviceSource:
    """Devices as a `Source`. Iterating starts them; leaving the iteration in any way halts them.

    snapshot  how they are doing

    Messages that were lost on the way are counted in the report as skipped. Raises DriverError where a device cannot be
    started, and when iterated again.
    """

    def __init__(self, specs: Sequence[DeviceSpec]) -> None:
        self.name = " + ".join(spec.text for spec in specs)
        self.report = SourceReport()
        self._acquisition = Acquisition(specs)
        self._read = False

    @property
    def snapshot(self) -> Snapshot:
        """See `Snapshot`."""
        return self._acquisition.snapshot

    def __iter__(self) -> Iterator[Message]:
        """The messages as they come."""
        if self._read:
            raise DriverError(f"{self.name}: can be read only once; record it to read it again")
        self._read = True
        with self._acquisition as acquisition:
            for message in acquisition:
                self.report.messages += 1
                count_losses(self.report, self.snapshot)
                yield message
        count_losses(self.report, self.snapshot)

    def __len__(self) -> int:
        """Nobody knows."""
        return 0

    def stop(self) -> None:
        """End the iteration after the last message that was measured."""
        self._acquisition.stop()


def count_losses(report: SourceReport, snapshot: Snapshot) -> None:
    """Enter into the report what the acquisition lost."""
    reasons = {
        "dropped, the messages were not taken fast enough": snapshot.dropped,
        "came after later ones had been given out": snapshot.late,
    }
    report.reasons = {reason: count for reason, count in reasons.items() if count}
    report.skipped = snapshot.dropped + snapshot.late
    report.first = next(iter(report.reasons), None)
