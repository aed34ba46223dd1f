"""A recording that takes as long as it took."""

from __future__ import annotations

import time
from collections.abc import Iterator

from ..messages import Message, Source, end_of


class Replay:
    """Plays a source with its timing, as a `Source`: a message comes when its last beam was measured.

    source  whose messages are played, stamps as they are
    speed   times as fast

    A consumer that is slow gets what is overdue at once, and nothing is dropped.
    """

    def __init__(self, source: Source, speed: float = 1.0) -> None:
        self.name, self.speed = source.name, speed
        self.report = source.report
        self._source = source

    def __iter__(self) -> Iterator[Message]:
        """The messages, from the beginning."""
        begun: float | None = None
        started = time.monotonic()
        for message in self._source:
            self.report = self._source.report
            if begun is None:
                begun = message.stamp
            due = started + (end_of(message) - begun) / self.speed
            time.sleep(max(0.0, due - time.monotonic()))
            yield message
        self.report = self._source.report

    def __len__(self) -> int:
        """About how many messages there are."""
        return len(self._source)
