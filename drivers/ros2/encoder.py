"""Serialise what a SLAM node publishes as ROS 2 messages in CDR."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import se2
from ..immutable import immutable
from ..messages import Floats, Odometry
from ..recordings.ros_encoder import RosEncoder
from ..recordings.ros_messages import DIAGNOSTICS, ODOMETRY
from ..se2 import Pose

POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
MARKERS = "visualization_msgs/msg/MarkerArray"
GRID = "nav_msgs/msg/OccupancyGrid"
GRID_INFO = "nav_msgs/msg/MapMetaData"

PLANE = (0, 1, 5)
"""Rows of x, y and the rotation about z in a covariance of ROS (6, 6)."""


class Level(IntEnum):
    """Levels of a DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


class Shape(IntEnum):
    """Types of a Marker: how its points are drawn."""

    LINE_STRIP = 4
    LINE_LIST = 5
    POINTS = 8


@immutable
class Drawing:
    """One Marker.

    name    its namespace; a later drawing of the same name replaces this one
    points  (n, 2) in the frame of the message, metres
    width   of lines, or side of points, metres
    colour  red, green, blue, opacity, 0 to 1
    """

    name: str
    shape: Shape
    points: Floats
    width: float
    colour: tuple[float, float, float, float]


@immutable
class Grid:
    """Occupancy grid as in nav_msgs/OccupancyGrid.

    cells       (rows, columns) 0: free, 100: occupied, -1: unknown; the first row has the lowest y
    origin      (2,) corner of the first cell, metres
    resolution  side of a cell, metres
    """

    cells: NDArray[np.int8]
    origin: Floats
    resolution: float


class NodeEncoder(RosEncoder):
    """Serialiser of poses, maps, markers and diagnostics."""

    def pose(self, stamp: float, frame: str, pose: Pose, covariance: Floats) -> bytes:
        """Encode a PoseWithCovarianceStamped.

        covariance  (3, 3) of [x, y, heading] in the pose's own frame; the message has it in the axes of `frame`
        """
        axes = se2.adjoint(np.array([0.0, 0.0, pose[2]]))
        whole = np.zeros((6, 6))
        whole[np.ix_(PLANE, PLANE)] = axes @ covariance @ axes.T
        content = self.types["geometry_msgs/msg/PoseWithCovariance"](self._pose(pose), whole.ravel())
        return self._serialise(POSE_WITH_COVARIANCE, self._header(stamp, frame), content)

    def base_odometry(self, reading: Odometry, frame: str, child: str, velocity: Floats) -> bytes:
        """Encode an Odometry of the frame `child` in `frame`, without covariances.

        velocity  (3,) in the frame of `child`: m/s, m/s, rad/s
        """
        types, unknown = self.types, np.zeros(36)
        vector = types["geometry_msgs/msg/Vector3"]
        vx, vy, turn_rate = velocity.tolist()
        twist = types["geometry_msgs/msg/Twist"](vector(vx, vy, 0.0), vector(0.0, 0.0, turn_rate))
        pose = types["geometry_msgs/msg/PoseWithCovariance"](self._pose(reading.pose), unknown)
        moving = types["geometry_msgs/msg/TwistWithCovariance"](twist, unknown)
        return self._serialise(ODOMETRY, self._header(reading.stamp, frame), child, pose, moving)

    def grid(self, stamp: float, frame: str, grid: Grid) -> bytes:
        """Encode an OccupancyGrid."""
        return bytes(self.store.serialize_cdr(self.grid_message(stamp, frame, grid), GRID))

    def grid_message(self, stamp: float, frame: str, grid: Grid) -> Any:
        """Return an OccupancyGrid, not serialised."""
        return self.types[GRID](self._header(stamp, frame), self._grid_info(stamp, grid), grid.cells.ravel())

    def grid_info(self, stamp: float, grid: Grid) -> bytes:
        """Encode the MapMetaData of a grid."""
        return bytes(self.store.serialize_cdr(self._grid_info(stamp, grid), GRID_INFO))

    def markers(self, stamp: float, frame: str, drawings: Sequence[Drawing]) -> bytes:
        """Encode a MarkerArray."""
        markers = [self._marker(self._header(stamp, frame), drawing) for drawing in drawings]
        return self._serialise(MARKERS, markers)

    def status(self, stamp: float, name: str, level: Level, text: str, values: dict[str, str]) -> bytes:
        """Encode a DiagnosticArray with one status."""
        pair = self.types["diagnostic_msgs/msg/KeyValue"]
        pairs = [pair(key, value) for key, value in values.items()]
        status = self.types["diagnostic_msgs/msg/DiagnosticStatus"](int(level), name, text, "", pairs)
        return self._serialise(DIAGNOSTICS, self._header(stamp, ""), [status])

    def _serialise(self, msgtype: str, *members: Any) -> bytes:
        return bytes(self.store.serialize_cdr(self.types[msgtype](*members), msgtype))

    def _grid_info(self, stamp: float, grid: Grid) -> Any:
        rows, columns = grid.cells.shape
        corner = self._pose(np.array([*grid.origin, 0.0]))
        return self.types[GRID_INFO](self._header(stamp, "").stamp, grid.resolution, columns, rows, corner)

    def _marker(self, header: Any, drawing: Drawing) -> Any:
        types, none = self.types, self.types["builtin_interfaces/msg/Time"](0, 0)
        vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
        nothing: NDArray[np.uint8] = np.zeros(0, dtype=np.uint8)
        empty_header = types["std_msgs/msg/Header"](none, "")
        flat = drawing.shape is Shape.POINTS
        return types["visualization_msgs/msg/Marker"](
            header=header,
            ns=drawing.name,
            id=0,
            type=int(drawing.shape),
            action=0,
            pose=self._pose(np.zeros(3)),
            scale=vector(drawing.width, drawing.width if flat else 0.0, 0.0),
            color=types["std_msgs/msg/ColorRGBA"](*drawing.colour),
            lifetime=types["builtin_interfaces/msg/Duration"](0, 0),
            frame_locked=False,
            points=[point(x, y, 0.0) for x, y in drawing.points.tolist()],
            colors=[],
            texture_resource="",
            texture=types["sensor_msgs/msg/CompressedImage"](empty_header, "", nothing),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=types["visualization_msgs/msg/MeshFile"]("", nothing),
            mesh_use_embedded_materials=False,
        )
