"""Events that the pipeline publishes: plain data, independent of the estimate, so that a sink may keep them."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from .loops import ComparedPoints, Correction, LoopCheck, LoopDecided
from .mapping import GraphInspected, KeyframeAdded, MapUpdated, WallsMerged, WallsRemoved
from .recorder import EventRecorder
from .run import Finished, Notice, SuspectFound
from .tracking import GroundTruthReceived, ModeChanged, Relocalised, ScanTracked, StateChanged

__all__ = [
    "ComparedPoints",
    "Correction",
    "Event",
    "EventRecorder",
    "Finished",
    "GraphInspected",
    "GroundTruthReceived",
    "KeyframeAdded",
    "LoopCheck",
    "LoopDecided",
    "MapUpdated",
    "ModeChanged",
    "Notice",
    "Relocalised",
    "ScanTracked",
    "Sink",
    "StateChanged",
    "SuspectFound",
    "WallsMerged",
    "WallsRemoved",
]

Event: TypeAlias = (
    ScanTracked
    | KeyframeAdded
    | MapUpdated
    | GraphInspected
    | WallsMerged
    | WallsRemoved
    | LoopDecided
    | StateChanged
    | ModeChanged
    | Relocalised
    | GroundTruthReceived
    | Notice
    | SuspectFound
    | Finished
)


class Sink(Protocol):
    """Receiver of events. It must return quickly: it is called while a scan is processed.

    A sink with an attribute `handled`, a tuple of types of events, receives only those. Events that no sink receives
    are not built: a summary of the whole map takes tens of milliseconds.
    """

    def handle(self, event: Event) -> None:
        """Handle one event."""
        ...
