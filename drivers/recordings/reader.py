"""What every reader of recordings shares: a path that exists, a report of what was skipped, messages in the
order of time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from ..errors import RecordingError
from ..messages import GroundTruth, Message, SourceReport
from .time_ordering import in_order

LATEST_STAMP = 2.0**31
"""Seconds; a later stamp (past January 2038) does not fit into the 32 bits that ROS has for it."""


def is_stamp(stamp: float) -> bool:
    """Whether a stamp (seconds) can be one: finite, not negative, before LATEST_STAMP."""
    return 0.0 <= stamp < LATEST_STAMP


class Recording(ABC):
    """A recording in a file or directory: a `Source` that can be read any number of times.

    A subclass yields the messages in the file's order from `_read` and calls `skip` for what it leaves out.
    Raises RecordingError when constructed with a path where nothing is, and when iteration finds not one
    scan or odometry.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = self.path.name
        self.report = SourceReport()
        if not self.path.exists():
            raise RecordingError(self.path, None, "no such file or directory")

    def __iter__(self) -> Iterator[Message]:
        """The messages, from the beginning, stamps never decreasing."""
        self.report = report = SourceReport()
        found = False
        try:
            for message in in_order(self._read(), self):
                report.messages += 1
                found = found or not isinstance(message, GroundTruth)
                yield message
        except OSError as error:
            raise RecordingError(self.path, None, f"cannot be read: {error.strerror or error}") from error
        if not found:
            why = f" ({report.first})" if report.first else ""
            raise RecordingError(self.path, None, f"{self._nothing_found()}{why}")

    def skip(self, line: int | None, reason: str) -> None:
        """Count an entry that is left out, and remember the first one's place (line or message number)."""
        self.report.skipped += 1
        self.note(line, reason)

    def note(self, line: int | None, reason: str) -> None:
        """Count an oddity that costs no message, such as messages that had to be sorted."""
        report = self.report
        report.reasons[reason] = report.reasons.get(reason, 0) + 1
        if report.first is None:
            report.first = str(RecordingError(self.path, line, reason))

    @abstractmethod
    def __len__(self) -> int:
        """About how many messages there are; 0 where unknown."""

    @abstractmethod
    def _read(self) -> Iterator[tuple[int, Message]]:
        """The line or message number (1-based) and the message, in the recording's own order."""

    def _nothing_found(self) -> str:
        """The reason that is given when there is not one usable message."""
        return "holds no laser scan and no odometry"
