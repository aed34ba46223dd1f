"""Draw loop decisions: as text, as rows of a table, as lines between keyframes, and as the correction of the map."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr

from drivers import se2

from ...events import ComparedPoints, Correction, LoopDecided
from ...formatting import counted
from ...geometry.segments import Floats
from ...loop_closure.loop_status import LoopStatus
from . import colours
from .colours import Colour
from .documents import loop_report
from .rrd_writer import RrdWriter
from .shapes import Height, dashed, to_3d
from .time_series import TimeSeries

DECISIONS, TABLE = "loops/decisions", "loops/table"
TABLE_COLUMNS = (
    "code",
    "keyframe",
    "looks",
    "margin",
    "overlap",
    "place",
    "rival",
    "shift",
)  # as the viewer sorts them
CODES = {LoopStatus.ACCEPTED: "A", LoopStatus.REJECTED: "R", LoopStatus.RETRACTED: "X"}
LEVELS = {
    LoopStatus.ACCEPTED: "INFO",
    LoopStatus.REJECTED: "DEBUG",
    LoopStatus.RETRACTED: "WARN",
}
DASHED = (LoopStatus.RETRACTED,)

_THIN, _THICK, _POINT = rr.Radius.ui_points(0.7), rr.Radius.ui_points(1.3), rr.Radius.ui_points(1.5)
_LOOP_WIDTH = rr.Radius.ui_points(2.0)
_MARKER = rr.components.MarkerShape
_MARKERS = {
    LoopStatus.ACCEPTED: _MARKER.Circle,
    LoopStatus.REJECTED: _MARKER.Cross,
    LoopStatus.RETRACTED: _MARKER.Square,
}


class DecisionLayer:
    """The last loop decision, and all accepted and retracted loops, which move with the map."""

    def __init__(self, writer: RrdWriter, time_series: TimeSeries) -> None:
        self._writer, self._time_series = writer, time_series
        self._accepted: dict[int, tuple[int, int, str]] = {}  # by keyframe: keyframe, old keyframe, label
        self._retracted: list[tuple[int, int, str]] = []
        self._decision_visible = False
        for name, colour in ((LoopStatus.ACCEPTED, colours.CLOSURE), (LoopStatus.RETRACTED, colours.CONTRADICTION)):
            style = rr.LineStrips3D.from_fields(colors=colour, radii=_LOOP_WIDTH, show_labels=False)
            writer.log_static(f"world/loops/{name}", style)
        writer.log_static("world/loops/candidate", rr.LineStrips3D.from_fields(radii=_LOOP_WIDTH, show_labels=True))

    def log_initial(self) -> None:
        """Log that there is no decision yet."""
        self._writer.log("loops/report", _markdown("No loop decision yet."))

    def log(self, event: LoopDecided, number: int, pose: se2.Pose, fit: float) -> None:
        """Log a decision with its running `number`, the keyframe's `pose` and the graph's chi² / dof."""
        level = LEVELS.get(event.status, "INFO")
        self._writer.log("log", rr.TextLog(_describe(event), level=level))
        self._writer.log("loops/report", _markdown(loop_report(event)))
        self._writer.log(DECISIONS, rr.AnyValues(drop_untyped_nones=True, **_row(event, number)))
        self._writer.log(TABLE, rr.AnyValues(**_table_row(event)))
        colour = _colour(event.status)
        self._time_series.mark("chi2", event.status, fit, colour, _MARKERS[event.status])
        self._update_loops(event)
        there = se2.compose(pose, event.motion)
        ends = np.stack([pose[:2], there[:2]])[None]
        if event.status in DASHED:
            ends = dashed(ends)
        labels = [f"x{event.index} to x{event.old} {event.status}", *([""] * (len(ends) - 1))]
        strips = rr.LineStrips3D.from_fields(strips=to_3d(ends, Height.DECISION), colors=colour, labels=labels)
        self._writer.log("world/loops/candidate", strips)
        self._decision_visible = True

    def clear(self) -> None:
        """Remove the last decision from the map, at the next keyframe."""
        if self._decision_visible:
            self._writer.log("world/loops/candidate", rr.LineStrips3D.from_fields(strips=[], colors=[], labels=[]))
            self._decision_visible = False

    def log_loops(self, keyframes: Floats) -> None:
        """Draw the accepted and retracted loops between the current poses of the keyframes (k, 3)."""
        self._draw(LoopStatus.ACCEPTED, list(self._accepted.values()), keyframes)
        self._draw(LoopStatus.RETRACTED, self._retracted, keyframes)

    def _update_loops(self, event: LoopDecided) -> None:
        loop = event.index, event.old, f"loop x{event.index} to x{event.old} {event.status}"
        if event.status == LoopStatus.ACCEPTED:
            self._accepted[event.index] = loop
        elif event.status == LoopStatus.RETRACTED:
            # Loops accepted after the retracted one depended on it and are undone with it.
            self._accepted = {index: other for index, other in self._accepted.items() if index < event.index}
            self._retracted.append(loop)

    def _draw(self, status: LoopStatus, loops: list[tuple[int, int, str]], keyframes: Floats) -> None:
        shown = [loop for loop in loops if max(loop[:2]) < len(keyframes)]
        pairs = np.array([loop[:2] for loop in shown], dtype=np.int64).reshape(-1, 2)
        ends = keyframes[pairs][..., :2]
        labels = [label for *_, label in shown]
        if status in DASHED:
            ends, labels = dashed(ends), labels if len(labels) == 1 else []
        strips = rr.LineStrips3D.from_fields(strips=to_3d(ends, Height.LOOP), labels=labels)
        self._writer.log(f"world/loops/{status}", strips)


class CorrectionLayer:
    """The points compared by the last decision, and the map before the last correction."""

    def __init__(self, writer: RrdWriter) -> None:
        self._writer = writer
        styles = {
            "world/before/walls": rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.BEFORE),
            "world/before/path": rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.BEFORE),
            "world/shift": rr.Arrows3D.from_fields(radii=_THIN, colors=colours.CLOSURE, show_labels=False),
            "compared_points/reference": rr.Points3D.from_fields(radii=_POINT, colors=colours.WALL),
            "compared_points/recent": rr.Points3D.from_fields(radii=_POINT, colors=colours.BEFORE),
            "compared_points/aligned": rr.Points3D.from_fields(radii=_POINT, colors=colours.MATCHED),
        }
        for entity, style in styles.items():
            writer.log_static(entity, style)
        writer.log_static("compared_points", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    def log(self, event: LoopDecided) -> None:
        """Log the points that a decision compared, and its correction of the map if there is one."""
        if event.compared is not None:
            self._log_compared_points(event.compared)
        if event.correction is not None:
            self._log_correction(event.correction)

    def _log_compared_points(self, compared: ComparedPoints) -> None:
        """Log the recent points before and after the hypothesis' motion, relative to the centre of the aligned ones."""
        centre = compared.aligned.mean(axis=0)
        rows = {
            "reference": (compared.old, Height.WALL),
            "recent": (compared.recent, Height.ODOMETRY),
            "aligned": (compared.aligned, Height.FEATURE),
        }
        for name, (points, height) in rows.items():
            self._writer.log(
                f"compared_points/{name}", rr.Points3D.from_fields(positions=to_3d(points - centre, height))
            )

    def _log_correction(self, correction: Correction) -> None:
        pieces, _ = correction.walls_before.piece_points()
        walls = rr.LineStrips3D.from_fields(strips=to_3d(pieces, Height.ODOMETRY))
        self._writer.log("world/before/walls", walls)
        path = [to_3d(correction.keyframe_poses_before, Height.ODOMETRY)] if len(correction.keyframe_poses) > 1 else []
        self._writer.log("world/before/path", rr.LineStrips3D.from_fields(strips=path))
        self._writer.log("world/shift", _shift_arrows(correction.keyframe_poses_before, correction.keyframe_poses))


def _shift_arrows(before: Floats, after: Floats) -> rr.Arrows3D:
    """Return arrows from each keyframe's old to its new position, labelled with the distance."""
    origins, tips = to_3d(before, Height.LINK), to_3d(after, Height.LINK)
    lengths = np.hypot(*(after - before)[:, :2].T)
    labels = [f"x{index} {length:.2f} m" for index, length in enumerate(lengths.tolist())]
    return rr.Arrows3D.from_fields(origins=origins, vectors=tips - origins, labels=labels)


def _colour(status: LoopStatus) -> Colour:
    """Return the colour of a decision; only a wrong closure has that of errors."""
    shades = {LoopStatus.ACCEPTED: colours.CLOSURE, LoopStatus.RETRACTED: colours.CONTRADICTION}
    return shades.get(status, colours.ODOMETRY)


def _markdown(text: str) -> rr.TextDocument:
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _describe(event: LoopDecided) -> str:
    """Return the decision as a line of the text log."""
    outcome = event.reason
    if event.status == LoopStatus.ACCEPTED:
        outcome = f"{counted(len(event.merged), 'wall')} merged, the robot moved by {event.shift:.2f} m"
    return f"loop {event.candidate} {event.status}: {outcome} (x{event.index} at x{event.old})"


def _table_row(event: LoopDecided) -> dict[str, Any]:
    """Return the columns of the viewer's table: short, rounded, and in the order of TABLE_COLUMNS."""
    failed = next((check.name for check in event.checks if not check.passed), "")
    return {
        "code": f"{CODES[event.status]} {failed}".strip(),
        "keyframe": event.index,
        "looks": event.matches,
        "margin": round(float(event.margin), 2),
        "overlap": round(float(event.overlap_ratio), 2),
        "place": event.old,
        "rival": round(float(event.runner_up), 2),
        "shift": round(float(event.shift), 2),
    }


def _row(event: LoopDecided, number: int) -> dict[str, Any]:
    """Return the decision as columns of the table, which can show scalars only."""
    x, y, heading = (float(value) for value in event.motion)
    row: dict[str, Any] = {
        "number": number,
        "loop": event.candidate,
        "at_keyframe": event.index,
        "old_keyframe": event.old,
        "status": event.status.value,
        "reason": event.reason,
        "x": x,
        "y": y,
        "heading_deg": math.degrees(heading),
        "merged": len(event.merged),
        "shift": float(event.shift),
        "margin": float(event.margin),
    }
    for check in event.checks:
        name = check.name.replace("-", "_")
        row |= {name: float(check.value), f"{name}_gate": float(check.gate)}
    if failed := next((check.name for check in event.checks if not check.passed), None):
        row["failed_check"] = failed
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
