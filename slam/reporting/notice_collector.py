"""Warnings of a run, for its summary."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import ClassVar

from ..events import Event, Notice

MAX_EQUAL_NOTICES = 1000
"""Equal warnings that a run keeps: a robot that is lost for a day has one at each scan."""


@dataclass(slots=True)
class NoticeCollector:
    """Sink that collects the texts of notices that are warnings, of equal ones the first MAX_EQUAL_NOTICES."""

    handled: ClassVar[tuple[type[Event], ...]] = (Notice,)
    texts: list[str] = field(default_factory=list)
    _counts: Counter[str] = field(default_factory=Counter)

    def handle(self, event: Event) -> None:
        """Process one event."""
        if isinstance(event, Notice) and event.level == "WARN":
            self._counts[event.text] += 1
            if self._counts[event.text] <= MAX_EQUAL_NOTICES:
                self.texts.append(f"{event.text} (at {event.stamp:.2f} s)")
            elif self._counts[event.text] == MAX_EQUAL_NOTICES + 1:
                self.texts.append(f"more than {MAX_EQUAL_NOTICES} times: {event.text}")
