"""Publish the events of the pipeline on ROS 2: transform, pose, markers, grid and diagnostics."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
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

from ..events import Event, Finished, KeyframeAdded, MapUpdated, Notice, ScanTracked, StateChanged, SuspectFound
from ..geometry.segments import Floats
from ..io.exports import Occupancy, OccupancyGrid, PlacedScan
from ..localisation.state import LocalisationStatus
from ..mapping.map_features import MapCorners, MapWalls
from .live_grid import LiveGrid
from .parameters import NodeParameters

if TYPE_CHECKING:
    from ..io.sessions import StoredSession

MARKER_TOPIC = "slam_toolbox/graph_visualization"
"""Topic of the markers, as in slam_toolbox."""
DIAGNOSTICS_PERIOD = 1.0
"""Seconds between two messages while the state stays the same."""
WALL_WIDTH, CORNER_SIZE, PATH_WIDTH = 0.05, 0.12, 0.03
"""Metres."""
WALL_COLOUR, CORNER_COLOUR, PATH_COLOUR = (0.1, 0.3, 0.8, 1.0), (0.9, 0.4, 0.1, 1.0), (0.2, 0.6, 0.2, 1.0)
LEVELS = {
    LocalisationStatus.OK: Level.OK,
    LocalisationStatus.DEGENERATE: Level.WARN,
    LocalisationStatus.LOST: Level.ERROR,
}


@dataclass(slots=True)
class _RunState:
    """What has been published in a run.

    odometry_in_map   pose of the odometry's frame in the map at the last scan; None before the first one
    transform_stamp   stamp of the last odometry reading with a transform, `status_stamp` that of the last status
    keyframe          pose of the last keyframe, and its `covariance` in its own frame; zero: unknown
    counts            sizes of map and graph
    """

    odometry_in_map: se2.Pose | None = None
    transform_stamp: float = float("-inf")
    status_stamp: float = float("-inf")
    keyframe: se2.Pose | None = None
    covariance: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    status: LocalisationStatus = LocalisationStatus.OK
    counts: dict[str, str] = field(default_factory=dict)
    notice: str = ""
    suspects: list[str] = field(default_factory=list)


class NodeOutputs:
    """Sink that publishes what happens, under the names of slam_toolbox. The topics exist from construction on.

    lidar  (2,) position of the lidar on the base, metres: start of the beams in the grid
    shift  seconds that were added to all stamps of the run
    """

    def __init__(
        self, link: Link, names: NodeNames, parameters: NodeParameters, *, predicts_odometry: bool = False
    ) -> None:
        """`predicts_odometry` if the robot has no odometry: its transform is published, too, once for each scan."""
        self._predicts_odometry = predicts_odometry
        self.lidar: Floats = np.zeros(2)
        self.shift = 0.0
        self._parameters, self._encoder, self._node = parameters, NodeEncoder(), names.node
        self._put_transform = link.publish(names.resolve("/tf"), TRANSFORMS, MOVING_TRANSFORMS)
        self._put_pose = link.publish(names.resolve("pose"), POSE_WITH_COVARIANCE, DEFAULT)
        self._put_grid = link.publish(names.resolve(parameters.map_name), GRID, LATCHED)
        self._put_grid_info = link.publish(names.resolve(f"{parameters.map_name}_metadata"), GRID_INFO, LATCHED)
        self._put_markers = link.publish(names.resolve(MARKER_TOPIC), MARKERS, LATCHED)
        self._put_diagnostics = link.publish(names.resolve("/diagnostics"), DIAGNOSTICS, DEFAULT)
        self._lock = threading.Lock()
        self._run = _RunState()
        self._grid: LiveGrid | None = None

    def begin(self, session: StoredSession | None) -> None:
        """Begin a run, with the keyframes of a session that it continues."""
        self._run, self.shift = _RunState(), 0.0
        parameters = self._parameters
        self._grid = grid = LiveGrid(
            parameters.resolution, parameters.map_update_interval, parameters.max_laser_range, self._publish_grid
        )
        if session is None:
            return
        poses = session.slam_state.mapper.keyframe_poses
        for keyframe, row in enumerate(session.scan_history().keyframes.tolist()):
            scan = session.scans[row]
            grid.add(scan.stamp, scan.features.points.all, self.lidar, poses[keyframe])

    def end(self) -> None:
        """End a run: no grid is drawn any more."""
        if self._grid is not None:
            self._grid.close()

    def current_grid(self) -> tuple[float, Occupancy] | None:
        """Return the stamp of the last keyframe and a grid with all keyframes; None if there is nothing to draw."""
        return None if self._grid is None else self._grid.current()

    def handle(self, event: Event) -> None:
        """Process one event of a run that has begun."""
        assert self._grid is not None
        match event:
            case ScanTracked():
                self._publish_pose(event)
            case KeyframeAdded():
                self._run.keyframe, self._run.covariance = event.pose, event.pose_covariance
                self._run.counts = {name: str(count) for name, count in event.counts.items()}
                self._grid.add(event.stamp - self.shift, event.points, self.lidar, event.pose)
            case MapUpdated():
                self._grid.move(event.keyframes)
                self._publish_markers(event.stamp, event.walls, event.corners, event.keyframes)
            case StateChanged():
                self._run.status = LocalisationStatus(event.state)
                self._publish_status(event.stamp)
            case Notice():
                self._run.notice = event.text
            case SuspectFound():
                self._run.suspects.append(event.text)
            case Finished():
                self._grid.move(event.keyframes)
                self._publish_markers(float(event.stamps[-1]), event.walls, event.corners, event.keyframes)
                self._publish_status(float(event.stamps[-1]))

    def publish_transform(self, stamp: float) -> None:
        """Publish the transform to the odometry's frame, stamped later than an odometry reading by transform_timeout.

        stamp  of the reading, seconds. Nothing is published before the first scan, and not more often than
               transform_publish_period says
        """
        period = self._parameters.transform_publish_period
        with self._lock:
            run = self._run
            if run.odometry_in_map is None or not period or 0.0 <= stamp - run.transform_stamp < period:
                return
            run.transform_stamp, pose = stamp, run.odometry_in_map
        parameters = self._parameters
        later = stamp + parameters.transform_timeout
        self._put_transform(self._encoder.transform(later, parameters.map_frame, parameters.odom_frame, pose))

    def _publish_pose(self, scan: ScanTracked) -> None:
        """Publish the pose of a scan unless the robot is lost; its covariance is that of the last keyframe, moved."""
        run = self._run
        with self._lock:
            run.odometry_in_map = se2.compose(scan.pose, se2.inverse(scan.odometry))
        if self._predicts_odometry:
            stamp, parameters = scan.stamp - self.shift, self._parameters
            base = self._encoder.transform(stamp, parameters.odom_frame, parameters.base_frame, scan.odometry)
            self._put_transform(base)
            self.publish_transform(stamp)
        if run.status is not LocalisationStatus.LOST:
            moved = np.eye(3) if run.keyframe is None else se2.adjoint(se2.between(scan.pose, run.keyframe))
            covariance = moved @ run.covariance @ moved.T
            frame, stamp = self._parameters.map_frame, scan.stamp - self.shift
            self._put_pose(self._encoder.pose(stamp, frame, scan.pose, covariance))
        if not 0.0 <= scan.stamp - run.status_stamp < DIAGNOSTICS_PERIOD:
            self._publish_status(scan.stamp)

    def _publish_status(self, stamp: float) -> None:
        run = self._run
        run.status_stamp = stamp
        level, text = LEVELS[run.status], run.status.value
        if run.suspects:
            level, text = max(level, Level.WARN), f"{text}, SUSPECT {run.suspects[0]}"
        values = {**run.counts, "notice": run.notice, "grid": self._grid.problem if self._grid else ""}
        name = f"{self._node}: localisation"
        self._put_diagnostics(self._encoder.status(stamp - self.shift, name, level, text, values))

    def _publish_markers(self, stamp: float, walls: MapWalls, corners: MapCorners, path: Floats) -> None:
        ends = walls.piece_points()[0].reshape(-1, 2)
        drawings: Sequence[Drawing] = (
            Drawing("walls", Shape.LINE_LIST, ends, WALL_WIDTH, WALL_COLOUR),
            Drawing("corners", Shape.POINTS, corners.position, CORNER_SIZE, CORNER_COLOUR),
            Drawing("path", Shape.LINE_STRIP, path[:, :2], PATH_WIDTH, PATH_COLOUR),
        )
        self._put_markers(self._encoder.markers(stamp - self.shift, self._parameters.map_frame, drawings))

    def _publish_grid(self, stamp: float, occupancy: Occupancy) -> None:
        grid = message_grid(occupancy)
        self._put_grid(self._encoder.grid(stamp, self._parameters.map_frame, grid))
        self._put_grid_info(self._encoder.grid_info(stamp, grid))


def warm_up() -> None:
    """Draw a grid and encode a message of each type, which compiles or loads what that needs."""
    drawn = OccupancyGrid(1.0)
    drawn.add(PlacedScan(0.0, np.zeros(2), np.ones((1, 2))))
    encoder, grid, pose = NodeEncoder(), message_grid(drawn.occupancy()), np.zeros(3)
    encoder.grid(0.0, "", grid)
    encoder.grid_info(0.0, grid)
    encoder.pose(0.0, "", pose, np.zeros((3, 3)))
    encoder.transform(0.0, "", "", pose)
    encoder.markers(0.0, "", [Drawing("", Shape.POINTS, np.zeros((1, 2)), 0.0, PATH_COLOUR)])
    encoder.status(0.0, "", Level.OK, "", {})


def message_grid(occupancy: Occupancy) -> Grid:
    """Return an occupancy grid as a message has it; the values of the cells are the same."""
    return Grid(occupancy.cells, occupancy.origin, occupancy.resolution)
