"""Sink that keeps all events."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from . import Event

Kind = TypeVar("Kind")


class EventRecorder:
    """Sink that keeps all events, in their order."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def handle(self, event: Event) -> None:
        """Keep one event."""
        self.events.append(event)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Return all events of one type, in their order."""
        return [event for event in self.events if isinstance(event, kind)]
