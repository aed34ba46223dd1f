"""How well the robot's place is known, as a lane over time and in words."""

from __future__ import annotations

import math

import rerun as rr

from ...events import StateChanged
from .colours import ESTIMATE, MATCHED, REFUSED
from .recording import Recording


class StateLayer:
    """Logs the state as it changes; it is OK from the beginning."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        shades = [ESTIMATE, MATCHED, REFUSED]
        recording.keep("state", rr.StateConfiguration(values=["OK", "DEGENERATE", "LOST"], colors=shades))

    def begin(self) -> None:
        """Log that there is nothing yet to be said against the pose."""
        self._recording.log("state", rr.StateChange(state="OK"))

    def log(self, event: StateChanged) -> None:
        """Log a change at the present time."""
        self._recording.log("state", rr.StateChange(state=event.state))
        text, level = _in_words(event)
        self._recording.log("log", rr.TextLog(text, level=level))


def _in_words(event: StateChanged) -> tuple[str, str]:
    """The state as a line of the text log, and the line's level."""
    match event.state:
        case "LOST":
            return "LOST: the robot is not where it was believed to be, and looks for itself in its map", "ERROR"
        case "DEGENERATE":
            heading = math.degrees(event.direction or 0.0)
            return f"DEGENERATE: along {heading:.0f}° in the map the pose rests on odometry alone", "WARN"
    return "OK: the pose is held in every direction", "INFO"
