"""From events to what is drawn: each kind of event and the entities it becomes.

Rows of a keyframe are stamped with both timelines. What happens between keyframes is stamped with `sensor_time` only:
on the timeline `keyframe` it would show the robot ahead of the scan that belongs to the keyframe.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from drivers import se2

from ..errors import OutputError
from ..events import (
    Event,
    Finished,
    KeyframeAdded,
    LinesMerged,
    LoopDecided,
    MapCorners,
    MapLines,
    MapUpdated,
    Noticed,
    ScanTracked,
    StateChanged,
    TruthSeen,
)
from ..segments import Floats
from . import colours, documents
from .blueprint import layout
from .colours import Colour
from .keyframes import KeyframeLayer
from .loops import LoopLayer
from .maps import log_corners, log_lines
from .metrics import Metrics
from .paths import GrowingPath
from .server import ViewerServer
from .shapes import Layer, bounds, lift
from .truth import TruthComparison

APPLICATION = "wclm-slam"  # the viewer keeps layouts by this name
EPOCH_STAMPS = 1e8  # stamps above are seconds since 1970, stamps below count from the recording's own start
NOTABLE_SHIFT = 0.1  # metres by which the path moved that are worth a line in the log
SERVER_MEMORY = "25%"  # of the computer's: what viewers that come late are shown; older rows are in the file only
ROOM_TO_GROW = 0.25  # of the map's size, on each side, when those who look on are shown more of it
FLUSH_PERIOD = 0.5  # seconds; live, shorter ones cost kilobytes each for their chunks, and viewers see no more
PATH_SPACING = 0.05  # metres between points of the odometry's and the true path

_THIN, _THICK = rr.Radius.ui_points(0.7), rr.Radius.ui_points(1.2)


class EventLog:
    """Writes events to a recording file. Not safe for threads; the methods raise what Rerun raises."""

    def __init__(
        self,
        path: Path,
        config: str,
        recording: str,
        versions: Mapping[str, str],
        server: ViewerServer | None = None,
    ) -> None:
        """Open `path`, let viewers come if there is a server for them, and log what never changes.

        Rerun's first calls take a few tenths of a second: better here than in the path of a scan.

        Raises OutputError where the file cannot be written.
        """
        self._stream = rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(flush_tick=FLUSH_PERIOD))
        self._stream.set_log_time_enabled(False)
        self._extent = self._shown = bounds(np.empty((0, 2)))
        self._watched = server is not None
        try:
            self._stream.set_sinks(*_sinks(path, server), default_blueprint=layout(*self._extent, truth=False))
        except (OSError, RuntimeError) as error:
            raise OutputError(f"{path}: cannot write the review log: {error}") from error
        self._log_documents(config, recording, versions)
        self._metrics = Metrics(self._stream)
        self._loops = LoopLayer(self._stream)
        self._pose = np.zeros(3)  # of the last keyframe
        self._keyframes = KeyframeLayer(self._stream, self._metrics)
        self._odometry, self._true_path = GrowingPath(PATH_SPACING), GrowingPath(PATH_SPACING)
        self._odometry_start: se2.Pose | None = None  # T_map_odom by the first keyframe
        self._truth = TruthComparison()
        self._truth_waiting: list[se2.Pose] = []  # true poses before there was an alignment
        self._recent: list[se2.Pose] = []  # keyframes since the whole path was drawn
        self._lines: MapLines | None = None
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
            case LinesMerged():
                self._at(event.index, event.stamp)
                self._say(f"L{event.absorbed} is the same wall as L{event.kept}: merged, d²={event.gate:.1f}", "INFO")
            case LoopDecided():
                self._at(event.index, event.stamp)
                self._say(*self._loops.describe(event))
                self._loops.log(event, self._pose)
            case StateChanged():
                self._at(self._index, event.stamp)
                self._say(*_state_in_words(event))
            case TruthSeen():
                self._write_truth(event)
            case Noticed():
                self._at(self._index, event.stamp)
                self._say(event.text, event.level)
            case Finished():
                self._write_finish(event)

    def note(self, text: str) -> None:
        """Say something about the log itself, at its end."""
        self._at(self._index, self._stamp)
        self._say(text, "WARN")

    def close(self) -> None:
        """Fit the layout to the map and write the file's footer."""
        final = layout(
            *self._extent, truth=self._truth.alignment is not None, usual_time=self._metrics.usual_top("time")
        )
        self._stream.send_blueprint(final)
        self._stream.flush()  # raises where the file could not be written, a full disk for one; disconnecting does not
        self._stream.disconnect()

    def _log_documents(self, config: str, recording: str, versions: Mapping[str, str]) -> None:
        if recording:
            self._stream.send_recording_name(recording)
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log_document("legend", documents.legend())
        self._log_document("config", documents.configuration(config, recording, versions))
        self._log_document("summary", documents.SUMMARY_PENDING)

    def _log_document(self, entity: str, markdown: str) -> None:
        self._stream.log(entity, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)

    def _at(self, index: int, stamp: float) -> None:
        """Stamp the next rows with a keyframe and the recording's time."""
        self._between(stamp)
        self._stream.set_time("keyframe", sequence=index)

    def _between(self, stamp: float) -> None:
        """Stamp the next rows with the recording's time only."""
        self._stream.disable_timeline("keyframe")
        nanoseconds = round(1e9 * stamp)
        if stamp > EPOCH_STAMPS:
            self._stream.set_time("sensor_time", timestamp=np.datetime64(nanoseconds, "ns"))
        else:
            self._stream.set_time("sensor_time", duration=np.timedelta64(nanoseconds, "ns"))

    def _say(self, text: str, level: str) -> None:
        self._stream.log("log", rr.TextLog(text, level=level))

    def _write_scan(self, event: ScanTracked) -> None:
        self._explained = event.explained
        self._between(event.stamp)
        self._keyframes.place_robot(event.pose)

    def _write_keyframe(self, event: KeyframeAdded) -> None:
        self._index, self._stamp, self._pose = event.index, event.stamp, event.pose
        self._at(event.index, event.stamp)
        self._keyframes.log(event, self._explained, self._lines, self._corners)
        self._recent.append(event.pose)
        self._log_path("recent", np.array(self._recent), Layer.ESTIMATE, colours.ESTIMATE)
        if self._odometry_start is None:
            self._odometry_start = se2.compose(event.pose, se2.inverse(event.odometry))
        by_odometry = se2.compose(self._odometry_start, event.odometry)
        self._odometry.append(float(by_odometry[0]), float(by_odometry[1]))
        self._log_growing("odometry", self._odometry, Layer.ODOMETRY, colours.ODOMETRY)
        self._log_growing("truth", self._true_path, Layer.TRUTH, colours.TRUTH)
        self._truth.add_keyframe(event.index, event.stamp, event.pose)
        self._log_truth_errors()

    def _write_map(self, event: MapUpdated) -> None:
        self._at(event.index, event.stamp)
        self._lines, self._corners = event.lines, event.corners
        self._log_map(event.lines, event.corners, event.keyframes)
        self._loops.log_accepted(event.keyframes)
        self._recent = [event.keyframes[-1]] if len(event.keyframes) else []
        self._metrics.log("chi2", {"chi²": event.chi2})
        if event.shift > NOTABLE_SHIFT:
            self._say(f"the path moved by up to {event.shift:.2f} m", "INFO")

    def _log_map(self, lines: MapLines, corners: MapCorners, path: Floats) -> None:
        log_lines(self._stream, lines)
        log_corners(self._stream, corners)
        self._log_path("estimate", path, Layer.ESTIMATE, colours.ESTIMATE)
        self._log_path("recent", np.empty((0, 2)), Layer.ESTIMATE, colours.ESTIMATE)
        self._extent = bounds(lines.end_points(), path)
        self._make_room()

    def _make_room(self) -> None:
        """Show those who look on the whole map when it has outgrown what they see; their own layout is lost then."""
        low, high = self._extent
        if not self._watched or (np.all(low >= self._shown[0]) and np.all(high <= self._shown[1])):
            return
        margin = ROOM_TO_GROW * float(np.max(high - low))
        self._shown = low - margin, high + margin
        self._stream.send_blueprint(layout(*self._shown, truth=False))

    def _write_truth(self, event: TruthSeen) -> None:
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
        self._log_map(event.lines, event.corners, event.poses if len(event.poses) else event.keyframes)
        self._log_growing("odometry", self._odometry, Layer.ODOMETRY, colours.ODOMETRY)
        self._log_growing("truth", self._true_path, Layer.TRUTH, colours.TRUTH)
        self._log_document("summary", documents.summary(event.summary))

    def _log_path(self, name: str, poses: Floats, layer: Layer, colour: Colour) -> None:
        strips = [lift(poses, layer)] if len(poses) > 1 else []
        self._stream.log(f"world/path/{name}", rr.LineStrips3D(strips, colors=colour, radii=_THICK))

    def _log_growing(self, name: str, path: GrowingPath, layer: Layer, colour: Colour) -> None:
        for number, points in path.changed():
            strip = rr.LineStrips3D([lift(points, layer)], colors=colour, radii=_THIN)
            self._stream.log(f"world/{name}/{number}", strip)


def _sinks(path: Path, server: ViewerServer | None) -> list[rr.FileSink | rr.GrpcServerSink]:
    file = rr.FileSink(path)
    if server is None:
        return [file]
    server.release()
    return [file, rr.GrpcServerSink(server.address, server.port, server_memory_limit=SERVER_MEMORY)]


def _state_in_words(event: StateChanged) -> tuple[str, str]:
    """The state as a line of the text log, and the line's level."""
    match event.state:
        case "LOST":
            return "LOST: the robot is not where it was believed to be, and looks for itself in its map", "ERROR"
        case "DEGENERATE":
            heading = math.degrees(event.direction or 0.0)
            return f"DEGENERATE: along {heading:.0f}° in the map the pose rests on odometry alone", "WARN"
    return "OK: the pose is held in every direction", "INFO"
