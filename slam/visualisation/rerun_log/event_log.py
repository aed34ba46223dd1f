"""Convert the pipeline's events into rows of the review log.

Rows of a keyframe are stamped with all timelines. Rows between keyframes are stamped with `sensor_time` only: on the
timeline `keyframe` they would show the robot ahead of the keyframe's scan. For the others
see `decision_steps`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import assert_never

import numpy as np
import rerun as rr

from ...events import (
    Event,
    Finished,
    GraphInspected,
    GroundTruthReceived,
    KeyframeAdded,
    LoopDecided,
    MapUpdated,
    ModeChanged,
    Notice,
    Relocalised,
    ScanTracked,
    StateChanged,
    SuspectFound,
    WallsMerged,
    WallsRemoved,
)
from ...formatting import counted
from ...geometry.segments import Floats
from ...loop_closure.loop_status import LoopStatus
from ...mapping.map_features import MapCorners, MapWalls
from .blueprint import Extent, layout
from .confidence_layer import log_confidence
from .decision_steps import DecisionSteps
from .factor_graph_layer import FactorGraphLayer
from .grid_layer import log_grid
from .ground_truth_layer import GroundTruthLayer
from .keyframe_layer import KeyframeLayer
from .loop_layer import CorrectionLayer, DecisionLayer
from .map_layer import MapLayer
from .path_layer import PathLayer
from .rrd_writer import FLUSH_PERIOD, PART_SIZE, RrdWriter
from .run_properties import log_run_properties, log_summary
from .scan_layer import CELL, ScanLayer
from .shapes import bounds, largest_sigmas
from .shown_area import NO_MAP, ShownArea
from .status_layer import StatusLayer
from .time_series import TimeSeries
from .viewer import ViewerServer

MIN_LOGGED_SHIFT = 0.1  # metres; larger shifts of the path are reported in the text log
GROWING_PATH_INTERVAL = 5  # keyframes between updates of the odometry path and the true path


class EventLog:
    """Writes events to a review log. Not thread-safe; the methods raise Rerun's errors."""

    def __init__(
        self,
        path: Path,
        config: str,
        recording: str,
        versions: Mapping[str, str],
        server: ViewerServer | None = None,
        part_size: int = PART_SIZE,
        seed: int | None = None,
        max_age: float = FLUSH_PERIOD,
    ) -> None:
        """Open `path`, accept viewers if there is a server, and log the static rows.

        Rerun's first calls take a few tenths of a second: better here than during a scan.

        Raises OutputError if the file cannot be written.
        """
        self._writer = RrdWriter(path, layout(Extent(*NO_MAP)), server, part_size, max_age)
        self._shown_area = ShownArea(self._writer, has_live_viewers=server is not None)
        log_run_properties(self._writer, config, recording, versions, seed)
        self._steps = DecisionSteps(self._writer)
        self._time_series = TimeSeries(self._writer)
        self._map_layer = MapLayer(self._writer)
        self._path_layer = PathLayer(self._writer)
        self._scan_layer = ScanLayer(self._writer)
        self._keyframe_layer = KeyframeLayer(self._writer, self._time_series)
        self._decision_layer = DecisionLayer(self._writer, self._time_series)
        self._correction_layer = CorrectionLayer(self._writer)
        self._factor_graph_layer = FactorGraphLayer(self._writer, self._time_series)
        self._status_layer = StatusLayer(self._writer)
        self._ground_truth_layer = GroundTruthLayer(self._writer, self._path_layer, self._time_series)
        self._index: int | None = None  # of the last keyframe
        self._added = 0  # keyframes of this run
        self._last_notice: tuple[str, int | None] | None = None  # with that keyframe
        self._stamp = 0.0  # of the last keyframe; without any, as if only localised, of the last map or scan
        self._pose = np.zeros(3)
        self._overlap_ratio = math.nan  # of the last scan
        self._dof = 0  # degrees of freedom of the graph; 0: unknown
        self._fit = math.nan  # chi² / dof
        self._keyframes = np.zeros((0, 3))  # all keyframes and landmarks as last received
        self._walls: MapWalls | None = None
        self._corners: MapCorners | None = None

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
                self._write_merge(event)
            case WallsRemoved():
                self._at(event.index, event.stamp)
                names = ", ".join(f"L{wall}" for wall in event.walls)
                self._log_text(f"{names}: removed from the map, scans have seen through", "INFO")
            case LoopDecided():
                self._write_decision(event)
            case StateChanged():
                self._at_last_keyframe(event.stamp)
                self._status_layer.log_change(event)
            case ModeChanged():
                self._at_last_keyframe(event.stamp)
                mode = "only localised in" if event.frozen else "extended"
                self._log_text(f"the map is {mode} from now on", "INFO")
            case Relocalised():
                self._write_relocalisation(event)
            case GroundTruthReceived():
                self._ground_truth_layer.add_true_pose(event.stamp, event.pose)
            case Notice():
                self._write_notice(event)
            case SuspectFound():
                self._at(event.index, event.stamp)
                self._status_layer.log_suspect(event)
            case Finished():
                self._write_finish(event)
            case _:
                assert_never(event)

    def write_waiting(self) -> None:
        """Write rows that have waited long enough for others to be written together with."""
        self._writer.send_due()

    def note(self, text: str) -> None:
        """Log a remark on the log itself, at its end."""
        self._at_last_keyframe(self._stamp)
        self._log_text(text, "WARN")

    @property
    def file_ended(self) -> bool:
        """True if nothing more is written into the file, as the disk is nearly full."""
        return self._writer.file_ended

    def close(self) -> None:
        """Fit the layout to the map, and finish the file."""
        self._steps.end()
        self._shown_area.finish(
            truth=self._ground_truth_layer.aligned,
            typical_time=self._time_series.typical_maximum("time"),
            corrected=self._steps.corrections > 0,
            fitted=self._time_series.count("chi2") > 1,
            mapped=self._added > 1,
        )
        self._writer.close()

    def _log_text(self, text: str, level: str) -> None:
        self._writer.log("log", rr.TextLog(text, level=level))

    def _at(self, index: int, stamp: float) -> None:
        """Stamp the next rows with sensor time and keyframe."""
        self._writer.set_time(stamp, index)

    def _at_last_keyframe(self, stamp: float) -> None:
        """Stamp the next rows with the sensor time and the last keyframe, which a continued session has already."""
        self._at(max(len(self._keyframes) - 1, 0) if self._index is None else self._index, stamp)

    def _between_keyframes(self, stamp: float) -> None:
        """Stamp the next rows with the sensor time only."""
        self._writer.set_time(stamp, None)

    def _write_notice(self, event: Notice) -> None:
        """Log a notice, unless it repeats the last one: a robot that slips for seconds would fill the text log."""
        self._at_last_keyframe(event.stamp)
        notice = event.text, self._index
        if notice != self._last_notice:
            self._log_text(event.text, event.level)
        self._last_notice = notice

    def _follow_without_keyframes(self, stamp: float) -> None:
        """Keep the stamp of an event for the rows at the end, unless there are keyframes, whose stamps are kept."""
        if self._index is None:
            self._stamp = stamp

    def _write_scan(self, event: ScanTracked) -> None:
        self._follow_without_keyframes(event.stamp)
        self._overlap_ratio = event.overlap_ratio
        self._writer.manage_files()  # not only at keyframes: in familiar places there are none for days
        self._between_keyframes(event.stamp)
        self._keyframe_layer.move_robot(event.pose)

    def _write_keyframe(self, event: KeyframeAdded) -> None:
        self._steps.end()
        self._writer.manage_files()
        first, previous = self._index is None, self._pose
        self._added += 1
        self._index, self._stamp, self._pose = event.index, event.stamp, event.pose
        self._at(event.index, event.stamp)
        if first:
            self._decision_layer.log_initial()
            self._status_layer.log_initial()
        self._decision_layer.clear()
        sigma = self._keyframe_layer.log(event, self._overlap_ratio, self._walls, self._corners)
        self._scan_layer.add(event.index, event.pose, event.points)
        self._factor_graph_layer.log_keyframe(event, None if first else previous)
        self._path_layer.add_keyframe(event.index, event.pose, event.odometry, sigma)
        if event.index % GROWING_PATH_INTERVAL == 0:
            self._path_layer.log_growing_paths()
        self._ground_truth_layer.add_keyframe(event.index, event.stamp, event.pose)

    def _write_merge(self, event: WallsMerged) -> None:
        self._at(event.index, event.stamp)
        self._factor_graph_layer.merge(event.index, event.absorbed, event.kept, loop=False)
        self._log_text(f"L{event.absorbed} merged into L{event.kept}, d²={event.gate:.1f}", "TRACE")

    def _write_decision(self, event: LoopDecided) -> None:
        """Log a loop decision at the last keyframe; a retracted loop was accepted at an earlier one."""
        self._steps.end()  # there may be two decisions at one keyframe
        self._steps.add(corrects=event.correction is not None)
        self._at(max(self._index or 0, event.index), event.stamp)
        pose = self._pose
        if event.correction is not None:
            self._fit = self._per_dof(event.correction.chi2)
            pose = event.correction.keyframe_poses_before[-1]
        elif event.index < len(self._keyframes):  # rejected some metres of driving later
            pose = self._keyframes[event.index]
        if event.status == LoopStatus.RETRACTED:
            self._factor_graph_layer.unmerge(event.index)
        self._decision_layer.log(event, self._steps.decisions, pose, self._fit)
        self._correction_layer.log(event)
        self._shown_area.show_decisions()
        for old, recent in event.merged if event.status == LoopStatus.ACCEPTED else ():
            self._factor_graph_layer.merge(event.index, recent, old, loop=True)

    def _write_relocalisation(self, event: Relocalised) -> None:
        index = self._index or 0
        self._at(index, event.stamp)
        self._status_layer.log_relocalisation(event)
        self._keyframe_layer.log_relocalisation(event, index)
        self._between_keyframes(event.stamp)
        self._keyframe_layer.move_robot(event.pose)

    def _write_map(self, event: MapUpdated) -> None:
        self._follow_without_keyframes(event.stamp)
        self._at(max(self._index or 0, event.index), event.stamp)
        self._walls, self._corners, self._keyframes = event.walls, event.corners, event.keyframe_poses
        self._log_map(event.walls, event.corners, event.keyframe_poses, event.keyframe_poses)
        if self._steps.is_correction_open and len(event.keyframe_poses):
            self._pose = event.keyframe_poses[-1]
            self._keyframe_layer.correct(self._pose, event.walls, event.corners)
        self._dof = event.dof
        self._fit = self._per_dof(event.chi2)
        if self._index is not None:  # not of the map before a refinement, which has no keyframe in this log
            self._time_series.log("chi2", {"chi² / dof": self._fit})
        if event.shift > MIN_LOGGED_SHIFT:
            self._log_text(f"the path moved by up to {event.shift:.2f} m", "INFO")

    def _per_dof(self, chi2: float) -> float:
        return chi2 / self._dof if self._dof > 0 else math.nan

    def _write_inspection(self, event: GraphInspected) -> None:
        if self._walls is not None and self._corners is not None:
            self._at(max(self._index or 0, event.index), event.stamp)
            self._factor_graph_layer.log(event, self._keyframes, self._walls, self._corners)

    def _log_map(self, walls: MapWalls, corners: MapCorners, path: Floats, keyframes: Floats) -> None:
        if self._index is not None and self._index >= len(keyframes):
            self._keyframe_layer.clear()
        self._map_layer.log(walls, corners)
        self._path_layer.log_estimate(path, keyframes)
        self._scan_layer.log_all(keyframes)
        self._decision_layer.log_loops(keyframes)
        self._shown_area.enlarge(*bounds(walls.end_points(), path))

    def _write_finish(self, event: Finished) -> None:
        self._steps.end()
        self._at_last_keyframe(self._stamp)
        keyframes = event.keyframes
        if not np.isnan(keyframes.covariance).all():
            self._path_layer.set_sigmas(largest_sigmas(keyframes.covariance[:, :2, :2]))
        path = event.poses if len(event.poses) else keyframes.poses
        self._log_map(event.walls, event.corners, path, keyframes.poses)
        self._path_layer.log_growing_paths()
        log_grid(self._writer, self._scan_layer.placed(keyframes.poses), CELL)
        log_confidence(self._writer, event)
        sizes = (keyframes, "keyframe"), (event.walls, "wall"), (event.corners, "corner")
        self._log_text(f"finished: {', '.join(counted(len(rows), noun) for rows, noun in sizes)}", "INFO")
        log_summary(self._writer, event.summary)
