"""From events to what is drawn: each kind of event and the entities it becomes.

Rows of a keyframe are stamped with all timelines. What happens between keyframes is stamped with `sensor_time` only: on
the timeline `keyframe` it would show the robot ahead of the scan that belongs to the keyframe.

On `candidate` and `closure` a row has the number of the decision, or the correction of the map, that comes next. So at
each step of these timelines everything is seen as it was right after that decision.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from drivers import se2

from ...events import (
    Event,
    Finished,
    GraphInspected,
    GroundTruthReceived,
    KeyframeAdded,
    LoopDecided,
    MapCorners,
    MapUpdated,
    MapWalls,
    Notice,
    ScanTracked,
    StateChanged,
    WallsMerged,
    WallsRemoved,
)
from ...geometry.segments import Floats
from . import colours, documents, maps
from .blueprint import Extent, layout
from .colours import Colour
from .corrections import CorrectionLayer
from .decisions import DecisionLayer
from .inspection import InspectionLayer
from .keyframes import KeyframeLayer
from .metrics import Metrics
from .paths import GrowingPath
from .recording import PART_SIZE, Recording
from .server import ViewerServer
from .shapes import Layer, bounds, lift
from .states import StateLayer
from .truth import TruthComparison

NOTABLE_SHIFT = 0.1  # metres by which the path moved that are worth a line in the log
ROOM_TO_GROW = 0.25  # of the map's size, on each side, when those who look on are shown more of it
GROWING_INTERVAL = 5  # keyframes after which odometry's and the true path are drawn on
PATH_SPACING = 0.05  # metres between points of the odometry's and the true path
CERTAIN, LESS_CERTAIN = 0.05, 0.2  # metres of sigma, between the shades of keyframes

_THIN, _THICK, _DOT = rr.Radius.ui_points(0.7), rr.Radius.ui_points(1.0), rr.Radius.ui_points(1.6)


class EventLog:
    """Writes events to a recording file. Not safe for threads; the methods raise what Rerun raises."""

    def __init__(
        self,
        path: Path,
        config: str,
        recording: str,
        versions: Mapping[str, str],
        server: ViewerServer | None = None,
        part_size: int = PART_SIZE,
        seed: int | None = None,
    ) -> None:
        """Open `path`, let viewers come if there is a server for them, and log what never changes.

        Rerun's first calls take a few tenths of a second: better here than in the path of a scan.

        Raises OutputError where the file cannot be written.
        """
        self._extent = self._shown = bounds(np.empty((0, 2)))
        self._watched = server is not None
        self._recording = Recording(path, layout(Extent(*self._extent)), server, part_size)
        self._log_documents(config, recording, versions, seed)
        self._decided = self._corrected = 0  # decisions on loops, and corrections of the map, before the last keyframe
        self._decisions = self._corrections = 0  # and until now
        self._metrics = Metrics(self._recording)
        self._decision_layer = DecisionLayer(self._recording, self._metrics)
        self._correction_layer = CorrectionLayer(self._recording)
        self._inspection = InspectionLayer(self._recording, self._metrics)
        self._states = StateLayer(self._recording)
        self._pose = np.zeros(3)  # of the last keyframe
        self._chi2 = math.nan
        self._keyframes = KeyframeLayer(self._recording, self._metrics)
        self._odometry, self._true_path = GrowingPath(PATH_SPACING), GrowingPath(PATH_SPACING)
        self._odometry_start: se2.Pose | None = None  # T_map_odom by the first keyframe
        self._truth = TruthComparison()
        self._truth_waiting: list[se2.Pose] = []  # true poses before there was an alignment
        self._recent: list[se2.Pose] = []  # keyframes since the whole path was drawn
        self._sigmas: dict[int, float] = {}  # of the keyframes' positions, metres
        self._path = np.zeros((0, 3))  # all keyframes, as last heard of
        self._lines: MapWalls | None = None
        self._corners: MapCorners | None = None
        self._index = 0
        self._stamp = 0.0
        self._explained = math.nan

    def write(self, event: Event) -> None:
        """Log one event."""
        match event:
            case ScanTracked():
                self._write_scan(event)
            case KeyframeAdded():
                self._write_keyframe(event)
            case MapUpdated():
                self._write_map(event)
            case GraphInspected():
                self._write_inspection(event)
            case WallsMerged():
                self._at(event.index, event.stamp)
                self._inspection.merge(event.index, event.absorbed, event.kept, loop=False)
                self._say(f"L{event.absorbed} is the same wall as L{event.kept}: merged, d²={event.gate:.1f}", "TRACE")
            case WallsRemoved():
                self._at(event.index, event.stamp)
                names = ", ".join(f"L{wall}" for wall in event.lines)
                self._say(f"{names}: no longer there, seen through again and again; retired from the map", "INFO")
            case LoopDecided():
                self._write_decision(event)
            case StateChanged():
                self._at(self._index, event.stamp)
                self._states.log(event)
            case GroundTruthReceived():
                self._write_truth(event)
            case Notice():
                self._at(self._index, event.stamp)
                self._say(event.text, event.level)
            case Finished():
                self._write_finish(event)

    def note(self, text: str) -> None:
        """Say something about the log itself, at its end."""
        self._at(self._index, self._stamp)
        self._say(text, "WARN")

    def close(self) -> None:
        """Fit the layout to the map and finish the file."""
        truth, usual = self._truth.alignment is not None, self._metrics.usual_top("time")
        self._recording.lay_out(layout(Extent(*self._extent, truth=truth, usual_time=usual)))
        self._recording.close()

    def _log_documents(self, config: str, recording: str, versions: Mapping[str, str], seed: int | None) -> None:
        if recording:
            self._recording.name(recording)
        told = {"recording": recording or None, "seed": seed} | {k.replace("-", "_"): v for k, v in versions.items()}
        if facts := {name: value for name, value in told.items() if value is not None}:
            self._recording.describe("run", facts)
        self._recording.keep("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        maps.prepare(self._recording)
        dots = rr.Points3D.from_fields(radii=_DOT, show_labels=False)
        self._recording.keep("world/path/keyframes", dots)
        self._log_document("legend", documents.legend())
        self._log_document("config", documents.configuration(config, recording, versions))
        self._log_document("summary", documents.SUMMARY_PENDING)

    def _log_document(self, entity: str, markdown: str) -> None:
        self._recording.keep(entity, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))

    def _at(self, index: int, stamp: float) -> None:
        """Stamp the next rows with all timelines."""
        self._recording.set_time(stamp, keyframe=index, candidate=self._decided + 1, closure=self._corrected + 1)

    def _between(self, stamp: float) -> None:
        """Stamp the next rows with the recording's time only."""
        self._recording.set_time(stamp, keyframe=None, candidate=None, closure=None)

    def _say(self, text: str, level: str) -> None:
        self._recording.log("log", rr.TextLog(text, level=level))

    def _write_scan(self, event: ScanTracked) -> None:
        self._explained = event.overlap_ratio
        self._between(event.stamp)
        self._keyframes.move_robot(event.pose)

    def _write_keyframe(self, event: KeyframeAdded) -> None:
        self._recording.begin_part_if_full()
        self._index, self._stamp, self._pose = event.index, event.stamp, event.pose
        self._decided, self._corrected = self._decisions, self._corrections
        self._at(event.index, event.stamp)
        if self._odometry_start is None:
            self._odometry_start = se2.compose(event.pose, se2.inverse(event.odometry))
            self._decision_layer.begin()
            self._states.begin()
        self._decision_layer.clear()
        self._sigmas[event.index] = self._keyframes.log(event, self._explained, self._lines, self._corners)
        self._recent.append(event.pose)
        self._log_path("recent", np.array(self._recent), Layer.ESTIMATE, colours.ESTIMATE)
        by_odometry = se2.compose(self._odometry_start, event.odometry)
        self._odometry.append(float(by_odometry[0]), float(by_odometry[1]))
        if event.index % GROWING_INTERVAL == 0:
            self._log_growing("odometry", self._odometry, Layer.ODOMETRY, colours.ODOMETRY)
            self._log_growing("truth", self._true_path, Layer.TRUTH, colours.TRUTH)
        self._truth.add_keyframe(event.index, event.stamp, event.pose)
        self._log_truth_errors()

    def _write_decision(self, event: LoopDecided) -> None:
        """A decision, at the last keyframe: a closure that is taken back was closed at an earlier one."""
        self._decided = self._decisions  # should there be two at a keyframe
        self._decisions += 1
        self._at(max(self._index, event.index), event.stamp)
        pose = self._pose
        if event.correction is not None:
            self._corrections += 1
            self._chi2 = event.correction.chi2
            pose = event.correction.keyframes_before[-1]
        if event.status == "retracted":
            self._inspection.unmerge(event.index)
        self._decision_layer.log(event, self._decisions, pose, self._chi2)
        self._correction_layer.log(event)
        for old, recent in event.merged if event.status == "accepted" else ():
            self._inspection.merge(event.index, recent, old, loop=True)

    def _write_map(self, event: MapUpdated) -> None:
        self._at(max(self._index, event.index), event.stamp)
        self._lines, self._corners, self._path = event.lines, event.corners, event.keyframes
        self._log_map(event.lines, event.corners, event.keyframes)
        self._log_keyframes(event.keyframes)
        self._decision_layer.log_map(event.keyframes)
        self._recent = [event.keyframes[-1]] if len(event.keyframes) else []
        if self._corrections > self._corrected and len(event.keyframes):
            self._keyframes.place(event.keyframes[-1])
        self._chi2 = event.chi2
        self._metrics.log("chi2", {"chi²": event.chi2})
        if event.shift > NOTABLE_SHIFT:
            self._say(f"the path moved by up to {event.shift:.2f} m", "INFO")

    def _write_inspection(self, event: GraphInspected) -> None:
        if self._lines is not None and self._corners is not None:
            self._at(max(self._index, event.index), event.stamp)
            self._inspection.log(event, self._path, self._lines, self._corners)

    def _log_map(self, lines: MapWalls, corners: MapCorners, path: Floats) -> None:
        maps.log_lines(self._recording, lines)
        maps.log_corners(self._recording, corners)
        self._log_path("estimate", path, Layer.ESTIMATE, colours.ESTIMATE)
        self._log_path("recent", np.empty((0, 2)), Layer.ESTIMATE, colours.ESTIMATE)
        self._extent = bounds(lines.end_points(), path)
        self._make_room()

    def _log_keyframes(self, keyframes: Floats) -> None:
        """The keyframes (k, 3) as dots, the darker the less certain they were when they were added."""
        sigmas = np.array([self._sigmas.get(index, math.nan) for index in range(len(keyframes))])
        shade = (sigmas > CERTAIN).astype(int) + (sigmas > LESS_CERTAIN)
        dots = rr.Points3D.from_fields(
            positions=lift(keyframes, Layer.KEYFRAME),
            colors=np.array(colours.ESTIMATE_SHADES, dtype=np.uint8)[shade],
            labels=[f"x{index} σ={100 * sigma:.0f} cm" for index, sigma in enumerate(sigmas.tolist())],
        )
        self._recording.log("world/path/keyframes", dots)

    def _make_room(self) -> None:
        """Show those who look on the whole map when it has outgrown what they see; their own layout is lost then."""
        low, high = self._extent
        if not self._watched or (np.all(low >= self._shown[0]) and np.all(high <= self._shown[1])):
            return
        margin = ROOM_TO_GROW * float(np.max(high - low))
        self._shown = low - margin, high + margin
        self._recording.lay_out(layout(Extent(*self._shown)))

    def _write_truth(self, event: GroundTruthReceived) -> None:
        self._truth.add_truth(event.stamp, event.pose)
        self._truth_waiting.append(event.pose)
        self._log_truth_errors()
        if self._truth.alignment is not None:
            for pose in self._truth_waiting:
                aligned = self._truth.in_map(pose)
                self._true_path.append(float(aligned[0]), float(aligned[1]))
            self._truth_waiting.clear()

    def _log_truth_errors(self) -> None:
        for error in self._truth.errors():
            self._at(error.index, error.stamp)
            values = {"position [cm]": 100 * error.position, "heading [°]": math.degrees(error.heading)}
            self._metrics.log("error", values)

    def _write_finish(self, event: Finished) -> None:
        self._at(self._index, self._stamp)
        if event.keyframe_covariance is not None:
            largest = np.linalg.eigvalsh(event.keyframe_covariance[:, :2, :2])[:, -1]
            self._sigmas = dict(enumerate(np.sqrt(np.maximum(largest, 0.0)).tolist()))
        self._log_map(event.lines, event.corners, event.poses if len(event.poses) else event.keyframes)
        self._log_keyframes(event.keyframes)
        self._decision_layer.log_map(event.keyframes)
        self._log_growing("odometry", self._odometry, Layer.ODOMETRY, colours.ODOMETRY)
        self._log_growing("truth", self._true_path, Layer.TRUTH, colours.TRUTH)
        self._log_document("summary", documents.summary(event.summary))

    def _log_path(self, name: str, poses: Floats, layer: Layer, colour: Colour) -> None:
        strips = [lift(poses, layer)] if len(poses) > 1 else []
        self._recording.log(f"world/path/{name}", rr.LineStrips3D(strips, colors=colour, radii=_THICK))

    def _log_growing(self, name: str, path: GrowingPath, layer: Layer, colour: Colour) -> None:
        for number, points in path.changed():
            strip = rr.LineStrips3D([lift(points, layer)], colors=colour, radii=_THIN)
            self._recording.log(f"world/{name}/{number}", strip)
