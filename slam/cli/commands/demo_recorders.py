"""Sinks that keep what the pictures of the demo and of the documentation show of a run."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from ...errors import MapError
from ...events import Event, EventRecorder, GroundTruthReceived, LoopDecided, MapUpdated
from ...io.tum import Trajectory
from ...loop_closure.loop_status import LoopStatus


class ClosureRecorder:
    """Sink that keeps the closure that moved the robot most, and the map right after it."""

    handled: ClassVar[tuple[type[Event], ...]] = (LoopDecided, MapUpdated)

    def __init__(self) -> None:
        self.decided: LoopDecided | None = None
        self.after: MapUpdated | None = None

    def handle(self, event: Event) -> None:
        """Process one event."""
        if isinstance(event, LoopDecided) and event.status == LoopStatus.ACCEPTED:
            if self.decided is None or event.shift > self.decided.shift:
                self.decided, self.after = event, None
        elif isinstance(event, MapUpdated) and self.after is None and self.decided is not None:
            self.after = event

    @property
    def found(self) -> bool:
        """True if a loop was closed."""
        return self.after is not None

    def plot(self, path: Path) -> None:
        """Draw the map before and after the closure. Raises MapError if there was none, and OutputError."""
        from ...visualisation.plots.run_plots import plot_closure

        if self.decided is None or self.after is None:
            raise MapError("no loop was closed")
        plot_closure(path, self.decided, self.after)


def true_trajectory(recorder: EventRecorder) -> Trajectory:
    """Return the true trajectory of a run, in the world's frame."""
    events = recorder.of(GroundTruthReceived)
    return Trajectory(np.array([event.stamp for event in events]), np.array([event.pose for event in events]))
