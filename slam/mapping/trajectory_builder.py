"""The driven path: every scan hangs on its keyframe, odometry bridges from the scans to the stamps between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from ..odometry.history import OdometryHistory


class TrajectoryBuilder:
    """Poses of the scans relative to their keyframes, so that they move with the map when it is corrected."""

    def __init__(self) -> None:
        self._stamps: list[float] = []
        self._keyframes: list[int] = []
        self._relative: list[se2.Pose] = []
        self._informations: list[Floats] = []

    def __deepcopy__(self, memo: dict[int, object]) -> TrajectoryBuilder:
        """The same path; what was added is never changed, so it is shared."""
        other = TrajectoryBuilder()
        other._stamps, other._keyframes = list(self._stamps), list(self._keyframes)
        other._relative, other._informations = list(self._relative), list(self._informations)
        return other

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, stamp: float, keyframe: int, relative: se2.Pose, information: Floats) -> None:
        """A scan's pose relative to a keyframe's, and the information (3, 3) of what it was placed by, in its frame."""
        self._stamps.append(stamp)
        self._keyframes.append(keyframe)
        self._relative.append(relative)
        self._informations.append(information)

    def relative_poses(self) -> tuple[Floats, NDArray[np.int64], Floats, Floats]:
        """Stamps (n,) of the scans, keyframes (n,) they hang on, poses (n, 3) relative to those, and informations."""
        relative = np.array(self._relative).reshape(-1, 3)
        informations = np.array(self._informations).reshape(-1, 3, 3)
        return np.array(self._stamps), np.array(self._keyframes), relative, informations

    def at_scans(self, keyframe_poses: Floats) -> tuple[Floats, Floats]:
        """Stamps (n,) and poses (n, 3) of the scans, given the keyframes' poses (k, 3)."""
        relative = np.array(self._relative).reshape(-1, 3)
        return np.array(self._stamps), se2.compose(keyframe_poses[self._keyframes], relative).reshape(-1, 3)

    def between(self, begin: float, end: float) -> TrajectoryBuilder:
        """What of it is from `begin` on and before `end` (seconds)."""
        part = TrajectoryBuilder()
        for row in np.flatnonzero((np.array(self._stamps) >= begin) & (np.array(self._stamps) < end)).tolist():
            part.add(self._stamps[row], self._keyframes[row], self._relative[row], self._informations[row])
        return part

    def at_odometry(self, keyframe_poses: Floats, odometry: OdometryHistory) -> tuple[Floats, Floats]:
        """Stamps (m,) and poses (m, 3) at every odometry reading; none where no scan is on the path.

        From the scan before it a reading is reached by odometry; what odometry misses up to the next scan is spread
        over the way between the two: wheels err as they roll, not while they stand.
        """
        stamps, poses = self.at_scans(keyframe_poses)
        if not len(stamps):
            return np.zeros(0), np.zeros((0, 3))
        at = odometry.stamps
        readings = odometry.poses
        scan_odometry = odometry.at_each(stamps)
        before = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(stamps) - 1)
        after = np.minimum(before + 1, len(stamps) - 1)
        bridged = se2.compose(poses[before], se2.between(scan_odometry[before], readings))
        arrived = se2.compose(poses[before], se2.between(scan_odometry[before], scan_odometry[after]))
        missed = poses[after] - arrived
        missed[:, 2] = se2.wrap(missed[:, 2])
        travelled = odometry.travelled
        scan_ways = np.interp(stamps, at, travelled)
        span = scan_ways[after] - scan_ways[before]
        part = np.clip((travelled - scan_ways[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        result = bridged + part[:, None] * missed
        result[:, 2] = se2.wrap(result[:, 2])
        return at, result
