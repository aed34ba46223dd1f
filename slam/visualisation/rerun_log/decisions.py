"""Loops as they are decided: in words, as rows of a table, and as lines to the place that the robot seemed to be at."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr

from drivers import se2

from ...events import LoopDecided
from ...geometry.segments import Floats
from . import colours
from .colours import Colour
from .documents import loop_report
from .metrics import Metrics
from .recording import Recording
from .shapes import Layer, dashed, lift

LEVELS = {"accepted": "INFO", "held": "INFO", "rejected": "DEBUG", "retracted": "ERROR"}
DASHED = ("held", "retracted")
EVENTS = "loops/events"

_WIDTH = rr.Radius.ui_points(2.0)
_MARKER = rr.components.MarkerShape
_MARKERS = {
    "accepted": _MARKER.Circle,
    "held": _MARKER.Diamond,
    "rejected": _MARKER.Cross,
    "retracted": _MARKER.Square,
}


class DecisionLayer:
    """The last decision, the closures that stand, which move with the map, and those that were taken back."""

    def __init__(self, recording: Recording, metrics: Metrics) -> None:
        self._recording, self._metrics = recording, metrics
        self._standing: dict[int, tuple[int, int, str]] = {}  # candidate: keyframe, old keyframe, label
        self._retracted: list[tuple[int, int, str]] = []
        self._shown = False  # whether the last decision is to be seen
        for name, colour in (("accepted", colours.CLOSURE), ("retracted", colours.REFUSED)):
            style = rr.LineStrips3D.from_fields(colors=colour, radii=_WIDTH, show_labels=False)
            recording.keep(f"world/loops/{name}", style)
        recording.keep("world/loops/candidate", rr.LineStrips3D.from_fields(radii=_WIDTH, show_labels=True))

    def begin(self) -> None:
        """Log that there is no decision yet."""
        self._recording.log("loops/report", _markdown("No place has looked known yet."))

    def log(self, event: LoopDecided, number: int, pose: se2.Pose, chi2: float) -> None:
        """Log the decision with its running `number`, seen from the keyframe's `pose`; `chi2` is the graph's."""
        level = LEVELS.get(event.status, "INFO")
        self._recording.log("log", rr.TextLog(_in_words(event), level=level))
        self._recording.log("loops/report", _markdown(loop_report(event)))
        self._recording.log(EVENTS, rr.AnyValues(drop_untyped_nones=True, **_row(event, number)))
        colour = _colour(event.status)
        self._metrics.mark("chi2", event.status, chi2, colour, _MARKERS[event.status])
        self._remember(event)
        there = se2.compose(pose, event.motion)
        ends = np.stack([pose[:2], there[:2]])[None]
        if event.status in DASHED:
            ends = dashed(ends)
        label = f"x{event.index} to x{event.old} {event.status}"
        label += f": {event.reason}" if event.status in ("rejected", "retracted") else ""
        labels = [label, *([""] * (len(ends) - 1))]
        strips = rr.LineStrips3D.from_fields(strips=lift(ends, Layer.DECISION), colors=colour, labels=labels)
        self._recording.log("world/loops/candidate", strips)
        self._shown = True

    def clear(self) -> None:
        """Another keyframe has come: the last decision is no longer shown."""
        if self._shown:
            self._recording.log("world/loops/candidate", rr.LineStrips3D.from_fields(strips=[], colors=[], labels=[]))
            self._shown = False

    def log_map(self, keyframes: Floats) -> None:
        """Draw the closures between keyframes (k, 3), as they are now."""
        self._draw("accepted", list(self._standing.values()), keyframes)
        self._draw("retracted", self._retracted, keyframes)

    def _remember(self, event: LoopDecided) -> None:
        loop = event.index, event.old, f"loop x{event.index} to x{event.old} {event.status}"
        if event.status == "accepted":
            self._standing[event.index] = loop
        elif event.status == "retracted":
            # those closed after it rested on it
            self._standing = {index: other for index, other in self._standing.items() if index < event.index}
            self._retracted.append(loop)

    def _draw(self, name: str, loops: list[tuple[int, int, str]], keyframes: Floats) -> None:
        shown = [loop for loop in loops if max(loop[:2]) < len(keyframes)]
        pairs = np.array([loop[:2] for loop in shown], dtype=np.int64).reshape(-1, 2)
        ends = keyframes[pairs][..., :2]
        labels = [label for *_, label in shown]
        if name in DASHED:
            ends, labels = dashed(ends), labels if len(labels) == 1 else []
        self._recording.log(
            f"world/loops/{name}", rr.LineStrips3D.from_fields(strips=lift(ends, Layer.LOOP), labels=labels)
        )


def _colour(status: str) -> Colour:
    return colours.CLOSURE if status in ("accepted", "held") else colours.REFUSED


def _markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _in_words(event: LoopDecided) -> str:
    """The decision as a line of the text log."""
    x, y, heading = event.motion
    where = f"x{event.index} at x{event.old}, {math.hypot(x, y):.2f} m, {math.degrees(heading):.1f}°"
    outcome = {
        "accepted": f"{len(event.merged)} walls merged, the robot moved by {event.shift:.2f} m",
        "held": "waits for a second look",
    }.get(event.status, event.reason)
    return f"loop {event.candidate} {event.status}: {outcome} ({where})"


def _row(event: LoopDecided, number: int) -> dict[str, Any]:
    """The decision as columns of a table: scalars only, which is all that the table shows."""
    x, y, heading = (float(value) for value in event.motion)
    row: dict[str, Any] = {
        "number": number,
        "loop": event.candidate,
        "at_keyframe": event.index,
        "old_keyframe": event.old,
        "status": event.status,
        "reason": event.reason,
        "x": x,
        "y": y,
        "heading_deg": math.degrees(heading),
        "merged": len(event.merged),
        "shift": float(event.shift),
    }
    for test in event.tests:
        name = test.name.replace("-", "_")
        row |= {name: float(test.value), f"{name}_gate": float(test.gate)}
    if failed := next((test.name for test in event.tests if not test.passed), None):
        row["failed_test"] = failed
    if event.correction is not None:
        correction = event.correction
        shifts = correction.shifts()
        row |= {
            "chi2_before": correction.chi2_before,
            "chi2_strained": correction.chi2_strained,
            "chi2_after": correction.chi2,
            "max_shift": float(shifts.max(initial=0.0)),
        }
    return row
