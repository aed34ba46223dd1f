"""Mounts of lidars on the robot, from the transforms (tf) of a ROS recording."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..immutable import immutable
from ..messages import Floats
from ..se2 import Pose
from .ros_messages import LidarMount, heading_of

BASE_FRAMES = ("base_link", "base_footprint", "base")
"""Names of the base's frame, tried in this order if the odometry's child frame is unknown."""
MAX_TRANSLATION = 1e6
"""Metres; longer transforms are invalid."""

MIN_TILT, MAX_TILT = math.radians(1.0), math.radians(60.0)
"""Tilts between which scans are projected: less changes ranges by less than their noise, and a lidar that is tilted
more does not measure along the floor."""

MOVED = 0.02
"""Metres, and about a degree as an element of a rotation, from which on a frame has moved."""


def normalize_frame(frame: str) -> str:
    """Return a frame's name without the leading slash that ROS 1 allowed."""
    return frame.lstrip("/")


@immutable
class _Link:
    """Transform from a frame to its parent: as stored in the message, and as a (4, 4) matrix."""

    parent: str
    transform: Any
    matrix: Floats


def is_odometry_frame(frame: str) -> bool:
    """Return True if a frame is that of odometry by its name, which contains `odom` by REP 105."""
    return "odom" in frame.rpartition("/")[2]


class TransformTree:
    """Tree of transforms between the frames of a robot.

    Those from the frame of odometry are left out: the robot moves in it, and so may other things, as the goal of a
    planner. A lidar that only they connect with a frame is not mounted there.
    """

    def __init__(self) -> None:
        self._parents: dict[str, _Link] = {}
        self._frames: set[str] = set()  # all that are named
        self._second: dict[str, Floats] = {}  # of each frame, a pose (4, 4) in its parent that is not the first one
        self._moving: set[str] = set()  # frames that have moved in their parents

    def add(self, message: Any) -> None:
        """Add the transforms of a TFMessage; the first of each frame counts. Raises ValueError if one is not rigid."""
        for stamped in message.transforms:
            child, parent = normalize_frame(stamped.child_frame_id), normalize_frame(stamped.header.frame_id)
            link = _Link(parent, stamped.transform, _matrix(stamped.transform))
            self._frames |= {child, parent}
            if is_odometry_frame(parent):
                continue
            first = self._parents.setdefault(child, link)
            if first.parent == parent and _differ(link.matrix, first.matrix):
                second = self._second.setdefault(child, link.matrix)
                if _differ(link.matrix, second):
                    self._moving.add(child)

    def find_mount(self, frame: str, odometry_child: str | None) -> LidarMount:
        """Return the mount of a lidar's frame; unknown if no chain of transforms connects it to the base.

        The base is the child frame of the odometry (`odometry_child`), else one of BASE_FRAMES. The mount's heading is
        the direction of the lidar's x axis, seen from above.
        """
        frame, child = normalize_frame(frame), normalize_frame(odometry_child or "")
        for base in (child,) if child else BASE_FRAMES:
            if (stored := self._stored_mount(base, frame)) is not None:
                return LidarMount(stored)
        chained = (self._chained_mount(base, frame) for base in (child, *BASE_FRAMES))
        return next((mount for mount in chained if mount is not None), LidarMount())

    def mount_on(self, base: str, frame: str) -> LidarMount:
        """Return the mount of a frame on this base and no other; unknown if no chain of transforms connects them."""
        base, frame = normalize_frame(base), normalize_frame(frame)
        if base == frame:
            return LidarMount(np.zeros(3))
        stored = self._stored_mount(base, frame)
        return LidarMount(stored) if stored is not None else self._chained_mount(base, frame) or LidarMount()

    def find_pose(self, frame: str, odometry_child: str | None) -> Floats | None:
        """Return the pose (4, 4) of a lidar's frame in that of the base, which is found as by `find_mount`."""
        poses = (self.pose_on(base, frame) for base in (odometry_child or "", *BASE_FRAMES))
        return next((pose for pose in poses if pose is not None), None)

    def pose_on(self, base: str, frame: str) -> Floats | None:
        """Return the pose (4, 4) of a frame in that of this base; None if no chain of transforms connects them."""
        base, frame = normalize_frame(base), normalize_frame(frame)
        root, lidar = self._from_root(frame)
        base_root, base_pose = self._from_root(base)
        return np.asarray(np.linalg.inv(base_pose) @ lidar) if base in self._frames and base_root == root else None

    def moves(self, frame: str, base: str | None) -> bool:
        """Return True if a frame moves on the base: a motor turns or tilts it."""
        frame = normalize_frame(frame)
        bases = (normalize_frame(base),) if base else BASE_FRAMES
        for _ in range(len(self._parents)):  # damaged data may contain cycles
            if frame in bases or frame not in self._parents:
                return False
            if frame in self._moving:
                return True
            frame = self._parents[frame].parent
        return False

    def disagreement(self, frame: str) -> tuple[float, float] | None:
        """Return by how much, in metres and radians, two transforms of a frame differ; None if they agree.

        None also of a frame that moves, of which all transforms may be right.
        """
        frame = normalize_frame(frame)
        if frame not in self._second or frame in self._moving:
            return None
        between = np.linalg.inv(self._parents[frame].matrix) @ self._second[frame]
        cosine = 0.5 * (float(np.trace(between[:3, :3])) - 1.0)
        return float(np.linalg.norm(between[:3, 3])), math.acos(min(1.0, max(-1.0, cosine)))

    def up_axis(self, base: str | None, frame: str) -> Floats:
        """Return the direction (3,) of the base's z axis in another frame; its own z axis if that is not connected."""
        frame = normalize_frame(frame)
        root, sensor = self._from_root(frame)
        for name in (normalize_frame(base),) if base else BASE_FRAMES:
            base_root, pose = self._from_root(name)
            if base_root == root:
                return np.asarray((np.linalg.inv(sensor) @ pose)[:3, 2])
        return np.array([0.0, 0.0, 1.0])

    def _stored_mount(self, base: str, frame: str) -> Pose | None:
        """Return the mount bit for bit as stored if a single planar transform connects frame and base, else None.

        Products of matrices would round it.
        """
        link = self._parents.get(frame)
        if link is None or link.parent != base:
            return None
        transform = link.transform
        if transform.rotation.x != 0.0 or transform.rotation.y != 0.0:
            return None
        mount = np.array([transform.translation.x, transform.translation.y, heading_of(transform.rotation)])
        mount.flags.writeable = False
        return mount

    def _chained_mount(self, base: str, frame: str) -> LidarMount | None:
        relative = self.pose_on(base, frame)
        if relative is None:
            return None
        heading = float(np.arctan2(relative[1, 0], relative[0, 0]))
        mount = np.array([relative[0, 3], relative[1, 3], _without_pi(heading)])
        mount.flags.writeable = False
        tilt = math.acos(min(1.0, abs(float(relative[2, 2]))))
        if tilt < MIN_TILT:
            return LidarMount(mount, bool(relative[2, 2] < 0.0))
        projection = _projection(relative[:3, :3], heading) if tilt < MAX_TILT else None
        return LidarMount(mount, bool(relative[2, 2] < 0.0), tilt, projection)

    def _from_root(self, frame: str) -> tuple[str, Floats]:
        """Return the root of a frame's tree, and the frame's pose in the root, a (4, 4) matrix."""
        pose = np.eye(4)
        for _ in range(len(self._parents)):  # damaged data may contain cycles
            if frame not in self._parents:
                break
            link = self._parents[frame]
            frame, pose = link.parent, link.matrix @ pose
        return frame, pose


def _projection(rotation: Floats, heading: float) -> Floats:
    """Return the projection (2, 2) of a lidar with a rotation (3, 3) on the base, see `LidarMount`."""
    c, s = math.cos(heading), math.sin(heading)
    return np.asarray(np.array([[c, s], [-s, c]]) @ rotation[:2, :2])


def _differ(one: Floats, other: Floats) -> bool:
    """Return True if two poses (4, 4) are so different that a frame has moved from one to the other."""
    return bool(np.abs(one - other).max() > MOVED)


def _matrix(transform: Any) -> Floats:
    """Return a geometry_msgs/Transform as a (4, 4) matrix; raises ValueError if it is not rigid."""
    r, t = transform.rotation, transform.translation
    norm = math.sqrt(r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w)
    if not 0.9 < norm < 1.1 or not all(abs(distance) < MAX_TRANSLATION for distance in (t.x, t.y, t.z)):
        raise ValueError("transform is not rigid")
    x, y, z, w = (part / norm for part in (r.x, r.y, r.z, r.w))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), t.x],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), t.y],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), t.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _without_pi(heading: float) -> float:
    """Return a heading in [-pi, pi] as one in [-pi, pi)."""
    return -np.pi if heading >= np.pi else heading
