"""Recording of a robot with two lidars: the scans of both, and the odometry, in time order."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import replace

from ..messages import Message, Scan, SourceReport
from .reader import RecordingReader


class TwoLidarRecording:
    """The scans of a second lidar together with all that the reader of the first one yields, as a `Source`.

    Each reader finds out how the scans of its lidar are to be read: unit, order of the beams, delay.

    first   reader of the first lidar's scans and of everything else
    second  reader of the same recording, of whose messages only the scans are used
    """

    def __init__(self, first: RecordingReader, second: RecordingReader) -> None:
        self.first, self.second = first, second
        self.name = first.name
        self.report = SourceReport()

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from the beginning, with non-decreasing stamps."""
        for message in heapq.merge(self.first, self._second_scans(), key=lambda message: message.stamp):
            self.report = self.first.report
            yield message
        self.report = self.first.report
        self.report.interpretations += [
            f"second lidar: {text}"
            for text in self.second.report.interpretations
            if text not in self.report.interpretations
        ]

    def __len__(self) -> int:
        """Return the approximate number of messages: the readers count the scans of all topics."""
        return len(self.first)

    def _second_scans(self) -> Iterator[Message]:
        for message in self.second:
            if isinstance(message, Scan):
                yield replace(message, lidar=1)
