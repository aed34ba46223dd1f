"""A listener for tests that collects the pipeline's events."""

from __future__ import annotations

from typing import TypeVar

from slam.events import Event

Kind = TypeVar("Kind")


class EventCollector:
    """A sink that keeps every event, in order."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def handle(self, event: Event) -> None:
        """Append one event."""
        self.events.append(event)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Return all events of one type, in order."""
        return [event for event in self.events if isinstance(event, kind)]
