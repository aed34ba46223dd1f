"""Replay of a recording in real time."""

from __future__ import annotations

import time
from collections.abc import Iterator

from ..messages import Message, Source, end_stamp


class Replay:
    """Replay of a source in real time, as a `Source`: a message is yielded when its last beam was measured.

    source  source of the messages; their stamps are not changed
    speed   factor on real time

    A slow consumer gets overdue messages without delay; no message is dropped.
    """

    def __init__(self, source: Source, speed: float = 1.0) -> None:
        self.name, self.speed = source.name, speed
        self.report = source.report
        self._source = source

    @property
    def source(self) -> Source:
        """Source of the messages."""
        return self._source

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from the beginning."""
        first_stamp: float | None = None
        started = time.monotonic()
        for message in self._source:
            self.report = self._source.report
            if first_stamp is None:
                first_stamp = message.stamp
            due = started + (end_stamp(message) - first_stamp) / self.speed
            time.sleep(max(0.0, due - time.monotonic()))
            yield message
        self.report = self._source.report

    def __len__(self) -> int:
        """Return the approximate number of messages."""
        return len(self._source)
