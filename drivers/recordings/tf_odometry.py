"""Odometry from transforms (tf), for robots that publish it nowhere else."""

from __future__ import annotations

from typing import Any

from .. import se2
from ..messages import Odometry
from ..se2 import Pose
from .ros_messages import planar_transform, stamp_of
from .transforms import TransformTree, normalize_frame


class TransformOdometry:
    """Reader of the pose of the base in the odometry's frame from messages on /tf.

    odometry_frame  parent of the transforms, for example odom
    base_frame      frame whose pose is wanted. If the odometry moves another frame, for example base_footprint
                    instead of base_link, fixed transforms must connect the two
    fixed           tree with the fixed transforms

    others  frames that the odometry moves, but which nothing connects with the base
    """

    def __init__(self, odometry_frame: str, base_frame: str, fixed: TransformTree) -> None:
        self._odometry_frame, self._base_frame = normalize_frame(odometry_frame), normalize_frame(base_frame)
        self._fixed = fixed
        self.others: set[str] = set()

    def readings(self, message: Any, received: int) -> list[Odometry]:
        """Return the readings in a TFMessage; raises ValueError if a transform is invalid.

        received  time of reception, nanoseconds; the stamp of transforms without one
        """
        readings = []
        for stamped in message.transforms:
            if normalize_frame(stamped.header.frame_id) == self._odometry_frame:
                child = normalize_frame(stamped.child_frame_id)
                offset = self._base_in(child)
                if offset is None:
                    self.others.add(child)
                else:
                    pose = planar_transform(stamped.transform)
                    moved = pose if offset is IN_PLACE else se2.compose(pose, offset)
                    readings.append(Odometry(stamp_of(stamped.header, received), moved))
        return readings

    def _base_in(self, frame: str) -> Pose | None:
        """Return the pose of the base in a frame; IN_PLACE if they are the same, None if it is unknown."""
        if frame == self._base_frame:
            return IN_PLACE
        return self._fixed.mount_on(frame, self._base_frame).pose


IN_PLACE: Pose = se2.wrap([0.0, 0.0, 0.0])
"""Pose of a frame in itself; poses are not composed with it, which could round them."""
