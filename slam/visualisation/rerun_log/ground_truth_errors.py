"""Compare keyframes with ground truth while the run goes on, for the error plot and the true path."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from drivers import se2

MAX_POSES = 20_000  # true poses kept; half of them outlast any delay of a keyframe
MAX_TIME_GAP = 1.0  # seconds between true poses between which a pose is interpolated


@dataclass(frozen=True, slots=True)
class KeyframeError:
    """Error of keyframe `index` when it was added: metres and radians."""

    index: int
    stamp: float
    position: float
    heading: float


class GroundTruthErrors:
    """True poses and keyframes, matched by their stamps whatever the order of arrival.

    The world frame is aligned with the map frame at the first keyframe with a true pose. The whole error of that
    keyframe is absorbed by the alignment, as with a robot that starts at a known pose.
    """

    def __init__(self) -> None:
        self.alignment: se2.Pose | None = None  # T_map_world
        self._stamps: list[float] = []
        self._poses: list[se2.Pose] = []
        self._pending: list[tuple[int, float, se2.Pose]] = []

    def add_true_pose(self, stamp: float, pose: se2.Pose) -> None:
        """Add a true pose in the world frame; one that is not later than the last is ignored."""
        if not self._stamps or stamp > self._stamps[-1]:
            self._stamps.append(stamp)
            self._poses.append(pose)

    def add_keyframe(self, index: int, stamp: float, pose: se2.Pose) -> None:
        """Add an estimated pose in the map frame."""
        if self._stamps:
            self._pending.append((index, stamp, pose))

    def to_map(self, pose: se2.Pose) -> se2.Pose:
        """Return a pose of the world frame in the map frame. The alignment must be known."""
        assert self.alignment is not None
        return se2.compose(self.alignment, pose)

    def new_errors(self) -> list[KeyframeError]:
        """Return the errors that have become computable: of keyframes not later than the last true pose."""
        found: list[KeyframeError] = []
        while self._pending and self._pending[0][1] <= self._stamps[-1]:
            index, stamp, pose = self._pending.pop(0)
            truth = self._true_pose_at(stamp)
            if truth is None:
                continue
            if self.alignment is None:
                self.alignment = se2.compose(pose, se2.inverse(truth))
            error = se2.between(self.to_map(truth), pose)
            found.append(KeyframeError(index, stamp, float(np.hypot(error[0], error[1])), abs(float(error[2]))))
        self._drop_old_poses()
        return found

    def _drop_old_poses(self) -> None:
        if not self._pending and len(self._stamps) > MAX_POSES:
            del self._stamps[: -MAX_POSES // 2], self._poses[: -MAX_POSES // 2]

    def _true_pose_at(self, stamp: float) -> se2.Pose | None:
        """Interpolate the true pose at a stamp not after the last one; None before the first and in gaps."""
        after = bisect_left(self._stamps, stamp)
        if self._stamps[after] == stamp:
            return self._poses[after]
        if after == 0 or self._stamps[after] - self._stamps[after - 1] > MAX_TIME_GAP:
            return None
        share = (stamp - self._stamps[after - 1]) / (self._stamps[after] - self._stamps[after - 1])
        motion = se2.between(self._poses[after - 1], self._poses[after])
        return se2.compose(self._poses[after - 1], share * motion)
