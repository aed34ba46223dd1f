"""Base class of all readers of recordings: checks the path, reports skipped entries, orders messages by time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from ..errors import RecordingError
from ..messages import GroundTruth, Message, SourceReport
from .time_ordering import order_by_time

MAX_STAMP = 2.0**31
"""Seconds. Later stamps (after January 2038) do not fit into the 32 bits of a ROS stamp."""


def is_valid_stamp(stamp: float) -> bool:
    """Return true if a stamp (seconds) is finite, not negative, and less than MAX_STAMP."""
    return 0.0 <= stamp < MAX_STAMP


class RecordingReader(ABC):
    """Recording in a file or directory: a `Source` that can be read any number of times.

    A subclass yields the messages in the file's order from `_read` and calls `skip` for entries that it omits. Raises
    RecordingError on construction if the path does not exist, and on iteration if there is no scan and no odometry.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = self.path.name
        self.report = SourceReport()
        if not self.path.exists():
            raise RecordingError(self.path, None, "no such file or directory")

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from the beginning, with non-decreasing stamps."""
        self.report = report = SourceReport()
        found = False
        try:
            for message in order_by_time(self._read(), self):
                report.messages += 1
                found = found or not isinstance(message, GroundTruth)
                yield message
        except OSError as error:
            raise RecordingError(self.path, None, f"cannot be read: {error.strerror or error}") from error
        if not found:
            first = f" ({report.first})" if report.first else ""
            raise RecordingError(self.path, None, f"{self._empty_reason()}{first}")

    def skip(self, line: int | None, reason: str) -> None:
        """Count an omitted entry; `line` is its line or message number."""
        self.report.skipped += 1
        self.note(line, reason)

    def note(self, line: int | None, reason: str) -> None:
        """Count an anomaly without loss of a message, such as messages that had to be sorted."""
        report = self.report
        report.reasons[reason] = report.reasons.get(reason, 0) + 1
        if report.first is None:
            report.first = str(RecordingError(self.path, line, reason))

    @abstractmethod
    def __len__(self) -> int:
        """Return the approximate number of messages; 0 if unknown."""

    @abstractmethod
    def _read(self) -> Iterator[tuple[int, Message]]:
        """Yield (line or message number, 1-based; message) in the recording's order."""

    def _empty_reason(self) -> str:
        """Return the error text for a recording without a usable message."""
        return "contains no laser scan and no odometry"
