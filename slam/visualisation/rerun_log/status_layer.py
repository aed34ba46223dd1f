"""Show the localisation status as a lane over time, and suspects as marks in the map; both also in the text log."""

from __future__ import annotations

import math

import rerun as rr

from ...events import Relocalised, StateChanged, SuspectFound
from .colours import CONTRADICTION, ESTIMATE, MATCHED
from .rrd_writer import RrdWriter
from .shapes import Height, to_3d

ENTITY = "localisation_status"
SUSPECTS_ENTITY = "world/suspects"
SUSPECT_RADIUS = 0.25  # metres


class StatusLayer:
    """The localisation status, OK at the beginning, relocalisations, and the suspects of the finished run."""

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        self._suspects = 0
        shades = [ESTIMATE, MATCHED, CONTRADICTION]
        writer.log_static(ENTITY, rr.StateConfiguration(values=["OK", "DEGENERATE", "LOST"], colors=shades))

    def log_initial(self) -> None:
        """Log the status OK."""
        self._writer.log(ENTITY, rr.StateChange(state="OK"))

    def log_change(self, event: StateChanged) -> None:
        """Log a change of the status at the current time."""
        self._writer.log(ENTITY, rr.StateChange(state=event.state))
        text, level = _describe(event)
        self._writer.log("log", rr.TextLog(text, level=level))

    def log_relocalisation(self, event: Relocalised) -> None:
        """Log the pose at which the robot was relocalised."""
        x, y, heading = (float(value) for value in event.pose)
        x, y, degrees = (value + 0.0 for value in (round(x, 2), round(y, 2), round(math.degrees(heading))))  # no "-0"
        text = f"relocalised in the map at ({x:.2f}, {y:.2f}) m, {degrees:.0f}°"
        self._writer.log("log", rr.TextLog(text, level="INFO"))

    def log_suspect(self, event: SuspectFound) -> None:
        """Mark a suspect in the map, from its own time on."""
        mark = rr.Points3D.from_fields(
            positions=to_3d(event.position[None], Height.DECISION),
            radii=[SUSPECT_RADIUS],
            colors=[CONTRADICTION],
            labels=[f"suspect {event.text}"],
            show_labels=False,
        )
        self._writer.log(f"{SUSPECTS_ENTITY}/{self._suspects}", mark)
        self._writer.log("log", rr.TextLog(f"SUSPECT {event.text}", level="WARN"))
        self._suspects += 1


def _describe(event: StateChanged) -> tuple[str, str]:
    """Return text and level of the status for the text log."""
    match event.state:
        case "LOST":
            return "LOST: the pose in the map is unknown; searching for it", "ERROR"
        case "DEGENERATE":
            heading = math.degrees(event.direction or 0.0)
            return f"DEGENERATE: position along {heading:.0f}° in the map from odometry alone", "WARN"
    return "OK: the pose is determined in every direction", "INFO"
