"""Facts on a recording for the summary of its run: gaps, timing, how it was read, and doubts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from drivers.gaps import gap_warnings
from drivers.messages import Message, Odometry, Scan, SourceReport

from ..geometry.growing_array import GrowingArray
from .recording_timing import RecordingTiming


class RecordingFacts:
    """Facts on a recording, complete once all its messages have been read.

    timing  of its lidar
    second  of its second lidar; None if there is none
    """

    def __init__(self, timing: RecordingTiming, second: RecordingTiming | None) -> None:
        self._timing, self._second = timing, second
        self._scan_stamps, self._odometry_stamps = GrowingArray(()), GrowingArray(())

    def read(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield the messages of the recording, and note when they were measured."""
        for message in messages:
            if isinstance(message, Odometry):
                self._odometry_stamps.append(message.stamp)
            elif isinstance(message, Scan):
                self._scan_stamps.append(message.stamp)
            yield message

    def figures(self, report: SourceReport) -> dict[str, Any]:
        """Return the facts as entries of summary.json; `report` of reading the recording."""
        read_as, doubts = [*report.interpretations], [*report.doubts]
        facts = {
            "gaps": gap_warnings(self._scan_stamps.rows, self._odometry_stamps.rows),
            "timing": self._timing.figures(),
            "interpretations": read_as,
            "doubts": doubts,
        }
        read_as += self._timing.corrections()
        doubts += self._timing.doubts()
        if (second := self._second) is not None:
            facts["second_timing"] = second.figures()
            read_as += [f"second lidar: {line}" for line in second.corrections()]
            doubts += [f"second lidar: {line.replace('lidar.mount', 'second_lidar.mount')}" for line in second.doubts()]
        return facts
