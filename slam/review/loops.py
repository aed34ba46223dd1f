"""Loop closures: each decision in words, and a line to the place that the robot seemed to be at."""

from __future__ import annotations

import numpy as np
import rerun as rr

from drivers import se2

from ..events import LoopDecided
from ..segments import Floats
from . import colours
from .shapes import Layer, lift

_WIDTH = rr.Radius.ui_points(2.0)


class LoopLayer:
    """The closures accepted so far, which move with the map, and the last decision."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._accepted: dict[int, tuple[int, int, str]] = {}  # candidate: keyframe, old keyframe, label

    def describe(self, event: LoopDecided) -> tuple[str, str]:
        """The decision as a line of the text log, and the line's level."""
        x, y, heading = event.motion
        text = (
            f"loop {event.candidate}: {event.status}; keyframe {event.index} looks like near keyframe {event.old}, "
            f"motion {x:.2f} m {y:.2f} m {np.degrees(heading):.1f}°, explains {event.explained:.0%} with "
            f"{event.matches} walls, another place {event.runner_up:.0%} of that, worst direction "
            f"{1e3 * event.sigma:.0f} mm, contradicted {event.contradicted:.0%}"
        )
        if event.status == "accepted":
            return f"{text}; {len(event.merged)} walls merged, moved by {event.shift:.2f} m", "INFO"
        level = {"rejected": "DEBUG", "retracted": "WARN"}.get(event.status, "INFO")
        return f"{text}; {event.reason}", level

    def log(self, event: LoopDecided, pose: se2.Pose) -> None:
        """Show the last decision from the keyframe's `pose`; remember an accepted one."""
        there = se2.compose(pose, event.motion)
        ends = np.stack([pose[:2], there[:2]])[None]
        colour = colours.CLOSURE if event.status == "accepted" else colours.REFUSED
        label = f"loop {event.candidate} {event.status}"
        self._strips("world/loops/last", ends, colour, [label])
        if event.status == "accepted":
            self._accepted[event.candidate] = event.index, event.old, label
        elif event.status == "retracted":
            self._accepted.pop(event.candidate, None)

    def log_accepted(self, keyframes: Floats) -> None:
        """Draw the accepted closures between keyframes (k, 3), as they are now."""
        shown = [loop for loop in self._accepted.values() if max(loop[:2]) < len(keyframes)]
        pairs = np.array([loop[:2] for loop in shown], dtype=np.int64).reshape(-1, 2)
        ends = keyframes[pairs][..., :2]
        self._strips("world/loops/accepted", ends, colours.CLOSURE, [label for *_, label in shown])

    def _strips(self, entity: str, ends: Floats, colour: colours.Colour, labels: list[str]) -> None:
        strips = rr.LineStrips3D(
            lift(ends, Layer.ESTIMATE), colors=colour, labels=labels, show_labels=False, radii=_WIDTH
        )
        self._stream.log(entity, strips)
