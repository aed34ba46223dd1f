"""Where lidars sit on a robot, from the transforms in a ROS recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..messages import Floats
from ..se2 import Pose
from .ros_messages import Placing, heading_of

BASE_FRAMES = ("base_link", "base_footprint", "base")
"""Names of the robot's own frame, tried in this order when the odometry does not name one that is known."""
FARTHEST = 1e6
"""Metres; no transform on a robot is longer."""


def plain(frame: str) -> str:
    """A frame's name as ROS 2 writes it, without the leading slash that ROS 1 allowed."""
    return frame.lstrip("/")


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    parent: str
    transform: Any  # as it was stored
    matrix: Floats  # the same, (4, 4)


class TransformTree:
    """Static transforms between frames."""

    def __init__(self) -> None:
        self._parents: dict[str, _Link] = {}

    def add(self, message: Any) -> None:
        """Take up a TFMessage; of transforms to one frame the first counts. Raises ValueError where one is none."""
        for stamped in message.transforms:
            child, parent = plain(stamped.child_frame_id), plain(stamped.header.frame_id)
            link = _Link(parent, stamped.transform, _matrix(stamped.transform))
            self._parents.setdefault(child, link)

    def placing(self, frame: str, odometry_child: str | None) -> Placing:
        """Where a lidar's frame is on the base; unknown where no chain of transforms connects the two.

        The base is the frame that the odometry moves (`odometry_child`), else one of BASE_FRAMES. A lidar
        hangs upside down where its z axis points down; its mount's heading is where its x axis points, seen
        from above.
        """
        root, lidar = self._from_root(plain(frame))
        for base in (plain(odometry_child or ""), *BASE_FRAMES):
            base_root, placed = self._from_root(base)
            known = base in self._parents or base in {link.parent for link in self._parents.values()}
            if base_root != root or not known:
                continue
            relative = np.linalg.inv(placed) @ lidar
            heading = float(np.arctan2(relative[1, 0], relative[0, 0]))
            mount = np.array([relative[0, 3], relative[1, 3], _tidy(heading)])
            mount.flags.writeable = False
            return Placing(mount, upside_down=bool(relative[2, 2] < 0.0))
        return Placing()

    def planar(self, frame: str, odometry_child: str | None) -> Pose | None:
        """The mount as it was written, where a single planar transform connects lidar and base; None
        elsewhere.

        It saves the rounding of products of matrices: what a recording says is then read back bit for bit.
        """
        link = self._parents.get(plain(frame))
        bases = {plain(odometry_child)} if odometry_child else set(BASE_FRAMES)
        if link is None or link.parent not in bases:
            return None
        transform = link.transform
        if transform.rotation.x != 0.0 or transform.rotation.y != 0.0:
            return None
        mount = np.array([transform.translation.x, transform.translation.y, heading_of(transform.rotation)])
        mount.flags.writeable = False
        return mount

    def _from_root(self, frame: str) -> tuple[str, Floats]:
        """The root above a frame, and the frame's pose in it, a (4, 4) matrix."""
        pose = np.eye(4)
        for _ in range(len(self._parents)):  # damaged data may go in circles
            if frame not in self._parents:
                break
            link = self._parents[frame]
            frame, pose = link.parent, link.matrix @ pose
        return frame, pose


def _matrix(transform: Any) -> Floats:
    """A geometry_msgs/Transform as a (4, 4) matrix; raises ValueError where its rotation is none."""
    r, t = transform.rotation, transform.translation
    norm = math.sqrt(r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w)
    if not 0.9 < norm < 1.1 or not all(abs(way) < FARTHEST for way in (t.x, t.y, t.z)):
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


def _tidy(heading: float) -> float:
    return -np.pi if heading >= np.pi else heading
