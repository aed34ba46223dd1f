"""Keyframes of the map: poses, covariances, and what they observed."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from drivers import se2

from ..geometry.growing_array import GrowingArray
from ..geometry.segments import Floats, Integers, Segments
from .keyframes import KeyframeMotion, KeyframeRecords, LandmarkIds

# Keyframes whose segments are kept for verifying loop closures. Origin: chosen, some 8 m of driving; not measured.
MAX_RECENT_SEGMENTS = 25


class MappedKeyframes:
    """Keyframes of a map. All attributes are read-only to other packages.

    keyframe_count   number of keyframes, k
    travelled        metres driven up to each keyframe; [0.0] before the first
    recent_segments  index and segments of the last MAX_RECENT_SEGMENTS keyframes
    landmark_ids     of each keyframe, as assigned when it was added
    """

    def __init__(self) -> None:
        self.keyframe_count = 0
        self.travelled = [0.0]
        self.recent_segments: deque[tuple[int, Segments]] = deque(maxlen=MAX_RECENT_SEGMENTS)
        self.landmark_ids: list[LandmarkIds] = []
        self._poses, self._pose_covariances = GrowingArray((3,)), GrowingArray((3, 3))
        self._correlated_drift = GrowingArray((2, 2))

    def restore_keyframes(self, records: KeyframeRecords, segments: Sequence[Segments]) -> None:
        """Restore saved keyframes, with the segments of each."""
        self.keyframe_count, self.keyframe_poses = len(records.keyframe_poses), records.keyframe_poses
        self.travelled, self.landmark_ids = list(records.travelled), list(records.landmark_ids)
        self.pose_covariances, self.correlated_drift = records.covariances, records.correlated_drift
        self.recent_segments.extend(enumerate(segments))

    def append_keyframe(
        self,
        pose: se2.Pose,
        motion: KeyframeMotion | None,
        segments: Segments,
        landmark_ids: LandmarkIds,
        correlated_drift: Floats,
    ) -> None:
        """Append a keyframe, except for the covariance of its pose.

        pose              [x, y, heading] in the map
        motion            to it from an earlier one; None for the first
        correlated_drift  (2, 2) covariance of the position by errors that neighbouring motions share
        """
        if motion is not None:
            self.travelled.append(self.travelled[-1] + float(np.hypot(motion.motion[0], motion.motion[1])))
        self._poses.append(pose)
        self._correlated_drift.append(correlated_drift)
        self.recent_segments.append((self.keyframe_count, segments))
        self.landmark_ids.append(landmark_ids)
        self.keyframe_count += 1

    def replace_last_poses(self, poses: Floats) -> None:
        """Replace the poses (n, 3) of the last keyframes."""
        self._poses.replace_last(poses)

    def replace_last_covariances(self, covariances: Floats) -> None:
        """Replace the covariances (n, 3, 3) of the last keyframes."""
        self._pose_covariances.replace_last(covariances)

    def equalise_covariances(self, keyframes: Integers | None = None) -> None:
        """Set the covariances of some keyframes, or of all, to that of the last one.

        They have their gauge in common then, and only differences of covariances are used.
        """
        covariances = self.pose_covariances.copy()
        covariances[slice(None) if keyframes is None else keyframes] = covariances[-1]
        self.pose_covariances = covariances

    def append_covariance(self) -> None:
        """Append a preliminary covariance of the last keyframe: that of the one before it.

        `replace_last_covariances` sets its own one when the graph has been solved with it. Until then local maps lack
        the uncertainty of the motion in between; data association adds that of tracking.
        """
        last = self.pose_covariances[-1] if len(self._pose_covariances) else np.zeros((3, 3))
        self._pose_covariances.append(last)

    @property
    def keyframe_records(self) -> KeyframeRecords:
        """Data of the keyframes that must be saved besides the graph."""
        return KeyframeRecords(
            self.keyframe_poses, self.travelled, self.landmark_ids, self.pose_covariances, self.correlated_drift
        )

    @property
    def keyframe_poses(self) -> Floats:
        """Poses (k, 3) of the keyframes in the map, as last read back: older ones only every FULL_READ_BACK_INTERVAL
        keyframes, and as tracked for those that the graph has not been solved with yet."""
        return self._poses.rows

    @keyframe_poses.setter
    def keyframe_poses(self, poses: Floats) -> None:
        self._poses.replace(poses)

    @property
    def pose_covariances(self) -> Floats:
        """Covariances (k, 3, 3) of each keyframe when it was added, in the map's axes, correlated drift included."""
        return self._pose_covariances.rows

    @pose_covariances.setter
    def pose_covariances(self, covariances: Floats) -> None:
        self._pose_covariances.replace(covariances)

    @property
    def correlated_drift(self) -> Floats:
        """Drift (k, 2, 2) accumulated up to each keyframe, in the map's axes; see `slam.odometry`."""
        return self._correlated_drift.rows

    @correlated_drift.setter
    def correlated_drift(self, drift: Floats) -> None:
        self._correlated_drift.replace(drift)

    @property
    def pose(self) -> se2.Pose:
        """Pose of the last keyframe in the map; zero before the first."""
        return np.zeros(3) if not len(self.keyframe_poses) else self.keyframe_poses[-1]
