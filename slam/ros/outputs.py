"""Publish the events of the pipeline on ROS 2: transform, pose, markers, grid and diagnostics."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from drivers.messages import Odometry
from drivers.recordings.ros_messages import DIAGNOSTICS, TRANSFORMS
from drivers.ros2.encoder import (
    GRID,
    GRID_INFO,
    MARKERS,
    POSE_WITH_COVARIANCE,
    Drawing,
    Grid,
    Level,
    NodeEncoder,
    Shape,
)
from drivers.ros2.link import DEFAULT, LATCHED, MOVING_TRANSFORMS, Link
from drivers.ros2.names import NodeNames

from ..events import (
    Event,
    Finished,
    KeyframeAdded,
    LoopDecided,
    MapUpdated,
    ModeChanged,
    Notice,
    ScanTracked,
    StateChanged,
    SuspectFound,
)
from ..geometry.segments import Floats
from ..io.exports import Occupancy
from ..io.exports.live_grid import LiveGrid
from ..localisation.state import LocalisationStatus
from ..loop_closure.loop_status import LoopStatus
from ..mapping.map_features import MapCorners, MapWalls
from ..pose_extrapolation import ExtrapolatedPose, PoseExtrapolator
from .parameters import NodeParameters

if TYPE_CHECKING:
    from ..io.sessions import StoredSession

MARKER_TOPIC = "slam_toolbox/graph_visualization"
"""Topic of the markers, as in slam_toolbox."""
DIAGNOSTICS_PERIOD = 1.0
"""Seconds between two messages while the state stays the same."""
WALL_WIDTH, CORNER_SIZE, PATH_WIDTH, CLOSURE_WIDTH = 0.05, 0.12, 0.03, 0.04
"""Metres."""
WALL_COLOUR, CORNER_COLOUR, PATH_COLOUR = (0.1, 0.3, 0.8, 1.0), (0.9, 0.4, 0.1, 1.0), (0.2, 0.6, 0.2, 1.0)
CLOSURE_COLOUR = (0.8, 0.1, 0.6, 1.0)
LEVELS = {
    LocalisationStatus.OK: Level.OK,
    LocalisationStatus.DEGENERATE: Level.WARN,
    LocalisationStatus.LOST: Level.ERROR,
}


@dataclass(slots=True)
class _RunState:
    """What has been published in a run.

    extrapolator     extrapolates the pose of the last scan
    localised        True once the robot was not LOST: before that, the map's frame is unknown
    transform_stamp  stamp of the last odometry reading with a transform, `status_stamp` that of the last status,
                 `reading_stamp` that of the last reading
    counts           sizes of map and graph
    frozen           True while the map is only localised in
    closures         keyframe at which each loop was closed -> keyframe that saw the place before
    """

    extrapolator: PoseExtrapolator = field(default_factory=PoseExtrapolator)
    localised: bool = False
    transform_stamp: float = float("-inf")
    status_stamp: float = float("-inf")
    reading_stamp: float = float("-inf")
    status: LocalisationStatus = LocalisationStatus.OK
    counts: dict[str, str] = field(default_factory=dict)
    closures: dict[int, int] = field(default_factory=dict)
    frozen: bool = False
    notice: str = ""
    suspects: list[str] = field(default_factory=list)


class NodeOutputs:
    """Sink that publishes what happens, under the names of slam_toolbox. The topics exist from construction on.

    lidars  number of each lidar -> (2,) its position on the base, metres: start of the beams in the grid
    shift   seconds that were added to all stamps of the run
    """

    def __init__(
        self, link: Link, names: NodeNames, parameters: NodeParameters, *, predicts_odometry: bool = False
    ) -> None:
        """`predicts_odometry` if the robot has no odometry: its transform is published, too, once for each scan."""
        self._predicts_odometry = predicts_odometry
        self.lidars: dict[int, Floats] = {0: np.zeros(2)}
        self.shift = 0.0
        self._parameters, self._encoder, self._node = parameters, NodeEncoder(), names.node
        self._put_transform = link.publish(names.resolve("/tf"), TRANSFORMS, MOVING_TRANSFORMS)
        self._put_pose = link.publish(names.resolve("pose"), POSE_WITH_COVARIANCE, DEFAULT)
        self._put_grid = link.publish(names.resolve(parameters.map_name), GRID, LATCHED)
        self._put_grid_info = link.publish(names.resolve(f"{parameters.map_name}_metadata"), GRID_INFO, LATCHED)
        self._put_markers = link.publish(names.resolve(MARKER_TOPIC), MARKERS, LATCHED)
        self._put_diagnostics = link.publish(names.resolve("/diagnostics"), DIAGNOSTICS, DEFAULT)
        self._lock, self._sending = threading.Lock(), threading.Lock()
        self._sent_grid: tuple[bytes, bytes] | None = None  # the last grid and its metadata
        self._grid_sent_at = float("-inf")  # on the steady clock
        self._run = _RunState()
        self._grid: LiveGrid | None = None
        self._missing: list[str] = []
        self._missing_sent_at = float("-inf")  # on the steady clock

    def begin(self, session: StoredSession | None, delay: float = 0.0) -> None:
        """Begin a run, with the keyframes of a session that it continues.

        delay  seconds by which the lidar's stamps are late against odometry's
        """
        self._run, self.shift, self._sent_grid = _RunState(PoseExtrapolator(delay)), 0.0, None
        parameters = self._parameters
        self._grid = grid = LiveGrid(
            parameters.resolution, parameters.map_update_interval, parameters.max_laser_range, self._publish_grid
        )
        if session is not None:
            grid.add_session(session, self._lidars)

    def end(self) -> None:
        """End a run: no grid is drawn any more."""
        if self._grid is not None:
            self._grid.close()

    def current_grid(self) -> tuple[float, Occupancy] | None:
        """Return the stamp of the last keyframe and a grid with all keyframes; None if there is nothing to draw."""
        return None if self._grid is None else self._grid.current()

    @property
    def _lidars(self) -> Floats:
        """Positions (k, 2) of the lidars on the base."""
        return np.array([*self.lidars.values()])

    def handle(self, event: Event) -> None:
        """Process one event of a run that has begun."""
        assert self._grid is not None
        if isinstance(event, PoseExtrapolator.handled):
            self._run.extrapolator.handle(event)
        match event:
            case ScanTracked():
                self._finish_scan(event)
            case KeyframeAdded():
                self._run.counts = {name: str(count) for name, count in event.counts.items()}
                self._grid.add(event.stamp - self.shift, event.points, self._lidars, event.pose)
            case MapUpdated():
                self._grid.move(event.keyframe_poses)
                self._publish_markers(event.stamp, event.walls, event.corners, event.keyframe_poses)
            case LoopDecided():
                self._keep_closure(event)
            case StateChanged():
                self._run.status = LocalisationStatus(event.state)
                self._publish_status(event.stamp)
            case ModeChanged():
                self._run.frozen = event.frozen
                self._publish_status(event.stamp)
            case Notice() if event.level != "TRACE":
                self._run.notice = event.text
            case SuspectFound():
                self._run.suspects.append(event.text)
            case Finished():
                self._grid.move(event.keyframes.poses)
                self._publish_markers(float(event.stamps[-1]), event.walls, event.corners, event.keyframes.poses)
                self._publish_status(float(event.stamps[-1]))

    def report_missing(self, missing: list[str]) -> None:
        """Publish that something has not arrived for some seconds, as lines of text, or arrives again (empty).

        To be called often: while scans are missing, nothing else publishes that the pose is by odometry alone.
        """
        now = time.monotonic()
        if missing == self._missing and not (missing and now >= self._missing_sent_at + DIAGNOSTICS_PERIOD):
            return
        self._missing, self._missing_sent_at = missing, now
        run = self._run
        stamp = max(run.status_stamp, run.reading_stamp + self.shift)
        if np.isfinite(stamp):
            self._publish_status(stamp)

    def publish_pose(self, reading: Odometry) -> None:
        """Publish the pose at an odometry reading, and the transform to the odometry's frame.

        The pose is that of the last scan, extrapolated by odometry; there is none while the robot is lost. The
        transform is stamped later than the reading by transform_timeout, and not published more often than
        transform_publish_period says. Nothing is published before the first scan, and no transform before the robot
        was recognised in the map of a session: navigation would take any pose there for the robot's.
        """
        self._run.reading_stamp = reading.stamp
        self._publish(self._run.extrapolator.at(reading))

    def _publish(self, now: ExtrapolatedPose | None) -> None:
        if now is None:
            return
        parameters, encoder = self._parameters, self._encoder
        period = parameters.transform_publish_period
        with self._lock:
            run = self._run
            run.localised |= now.status is not LocalisationStatus.LOST
            is_due = run.localised and bool(period) and not 0.0 <= now.stamp - run.transform_stamp < period
            run.transform_stamp = now.stamp if is_due else run.transform_stamp
        if is_due:
            later, frames = now.stamp + parameters.transform_timeout, (parameters.map_frame, parameters.odom_frame)
            self._put_transform(encoder.transform(later, *frames, now.odometry_in_map))
        if now.status is not LocalisationStatus.LOST:
            self._put_pose(encoder.pose(now.stamp, parameters.map_frame, now.pose, now.covariance))

    def _finish_scan(self, scan: ScanTracked) -> None:
        """Publish what comes with a scan: the status, and the pose if there is no odometry to publish it with."""
        if self._predicts_odometry:
            stamp, parameters = scan.stamp - self.shift, self._parameters
            base = self._encoder.transform(stamp, parameters.odom_frame, parameters.base_frame, scan.odometry)
            self._put_transform(base)
            self._publish(self._run.extrapolator.at_scan(stamp))
        if not 0.0 <= scan.stamp - self._run.status_stamp < DIAGNOSTICS_PERIOD:
            self._publish_status(scan.stamp)
            self._send_grid()

    def _publish_status(self, stamp: float) -> None:
        run = self._run
        run.status_stamp = stamp
        level, text = LEVELS[run.status], run.status.value
        if run.suspects:
            level, text = max(level, Level.WARN), f"{text}, SUSPECT {run.suspects[0]}"
        if self._missing:
            level, text = max(level, Level.WARN), f"{text}, {self._missing[0]}"
        mode = "localization" if run.frozen else "mapping"
        values = {**run.counts, "mode": mode, "notice": run.notice, "grid": self._grid.problem if self._grid else ""}
        name = f"{self._node}: localisation"
        self._put_diagnostics(self._encoder.status(stamp - self.shift, name, level, text, values))

    def _keep_closure(self, event: LoopDecided) -> None:
        closures = self._run.closures
        if event.status == LoopStatus.ACCEPTED:
            closures[event.index] = event.old
        elif event.status == LoopStatus.RETRACTED:  # with those that were closed after it
            self._run.closures = {index: old for index, old in closures.items() if index < event.index}

    def _publish_markers(self, stamp: float, walls: MapWalls, corners: MapCorners, path: Floats) -> None:
        ends = walls.piece_points()[0].reshape(-1, 2)
        pairs = [pair for pair in self._run.closures.items() if max(pair) < len(path)]
        closures = path[np.array(pairs, dtype=np.int64).ravel(), :2]
        drawings: Sequence[Drawing] = (
            Drawing("walls", Shape.LINE_LIST, ends, WALL_WIDTH, WALL_COLOUR),
            Drawing("corners", Shape.POINTS, corners.position, CORNER_SIZE, CORNER_COLOUR),
            Drawing("path", Shape.LINE_STRIP, path[:, :2], PATH_WIDTH, PATH_COLOUR),
            Drawing("closures", Shape.LINE_LIST, closures, CLOSURE_WIDTH, CLOSURE_COLOUR),
        )
        self._put_markers(self._encoder.markers(stamp - self.shift, self._parameters.map_frame, drawings))

    def _publish_grid(self, stamp: float, occupancy: Occupancy) -> None:
        grid = message_grid(occupancy)
        encoded = self._encoder.grid(stamp, self._parameters.map_frame, grid)
        self._send_grid((encoded, self._encoder.grid_info(stamp, grid)))

    def _send_grid(self, messages: tuple[bytes, bytes] | None = None) -> None:
        """Publish a grid and its metadata; None: the last ones again, if no other was published for an interval.

        Subscribers that do not ask for latched messages, as RViz by default, get a map that does not change, too.
        """
        with self._sending:
            now = time.monotonic()
            if messages is None and now < self._grid_sent_at + self._parameters.map_update_interval:
                return
            self._sent_grid, self._grid_sent_at = messages or self._sent_grid, now
            if self._sent_grid is not None:
                self._put_grid(self._sent_grid[0])
                self._put_grid_info(self._sent_grid[1])


def warm_up() -> None:
    """Encode a message of each type, which loads what that needs."""
    drawn = Occupancy(np.zeros((1, 1), dtype=np.int8), np.zeros(2), 1.0)
    encoder, grid, pose = NodeEncoder(), message_grid(drawn), np.zeros(3)
    encoder.grid(0.0, "", grid)
    encoder.grid_info(0.0, grid)
    encoder.pose(0.0, "", pose, np.zeros((3, 3)))
    encoder.transform(0.0, "", "", pose)
    encoder.markers(0.0, "", [Drawing("", Shape.POINTS, np.zeros((1, 2)), 0.0, PATH_COLOUR)])
    encoder.status(0.0, "", Level.OK, "", {})


def message_grid(occupancy: Occupancy) -> Grid:
    """Return an occupancy grid as a message has it; the values of the cells are the same."""
    return Grid(occupancy.cells, occupancy.origin, occupancy.resolution)
