"""Devices as a `Source`, which can be iterated only once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..errors import DriverError
from ..messages import Message, SourceReport
from .acquisition import Acquisition
from .device_spec import DeviceSpec, check_robot
from .snapshot import Snapshot


class DeviceSource:
    """Devices as a `Source`. Iterating starts them; leaving the iteration in any way halts them.

    snapshot  status of the devices

    Lost messages are counted in the report as skipped. Raises SpecError if the devices cannot be those of one robot,
    and DriverError if a device cannot be started, or on a second iteration.
    """

    def __init__(self, specs: Sequence[DeviceSpec]) -> None:
        check_robot(specs)
        self.name = " + ".join(spec.text for spec in specs)
        self.report = SourceReport()
        self._acquisition = Acquisition(specs)
        self._read = False

    @property
    def snapshot(self) -> Snapshot:
        """Status of the devices, see `Snapshot`."""
        return self._acquisition.snapshot

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages as they arrive."""
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
        """Return 0: the number of messages is unknown."""
        return 0

    def stop(self) -> None:
        """Stop measuring; the iteration ends after the last measured message."""
        self._acquisition.stop()


def count_losses(report: SourceReport, snapshot: Snapshot) -> None:
    """Write the acquisition's losses to the report."""
    reasons = {
        "dropped, the messages were not processed fast enough": snapshot.dropped,
        "arrived after later messages had been delivered": snapshot.late,
    }
    report.reasons = {reason: count for reason, count in reasons.items() if count}
    report.skipped = snapshot.dropped + snapshot.late
    report.first = next(iter(report.reasons), None)
