"""The driven path: every scan hangs on its keyframe, odometry bridges from the scans to the stamps between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from .graph import smooth_chain
from .odometry import OdometryHistory, OdometryNoise
from .segments import Floats

# Of the information that a scan's placement claims: scans beside it share the errors of the walls that it is laid over.
# On recordings a third is best by a little, a tenth and all of it are as good as each other.
CLAIMED_SHARE = 0.3


class Path:
    """Poses of the scans relative to their keyframes, so that they move with the map when it is corrected."""

    def __init__(self) -> None:
        self._stamps: list[float] = []
        self._keyframes: list[int] = []
        self._relative: list[se2.Pose] = []
        self._informations: list[Floats] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, stamp: float, keyframe: int, relative: se2.Pose, information: Floats) -> None:
        """A scan's pose relative to a keyframe's, and the information (3, 3) of what it was placed by, in its frame."""
        self._stamps.append(stamp)
        self._keyframes.append(keyframe)
        self._relative.append(relative)
        self._informations.append(information)

    def hung(self) -> tuple[Floats, NDArray[np.int64], Floats]:
        """Stamps (n,) of the scans, keyframes (n,) they hang on, and poses (n, 3) relative to those."""
        return np.array(self._stamps), np.array(self._keyframes), np.array(self._relative).reshape(-1, 3)

    def at_scans(self, keyframe_poses: Floats) -> tuple[Floats, Floats]:
        """Stamps (n,) and poses (n, 3) of the scans, given the keyframes' poses (k, 3)."""
        relative = np.array(self._relative).reshape(-1, 3)
        return np.array(self._stamps), se2.compose(keyframe_poses[self._keyframes], relative).reshape(-1, 3)

    def smoothed(self, keyframe_poses: Floats, odometry: OdometryHistory, noise: OdometryNoise) -> Path:
        """The path made even: the poses of the scans as they and the odometry between them are likeliest together.

        Where a scan was placed badly, or by little, its neighbours know better. Raises MapError.
        """
        stamps, poses = self.at_scans(keyframe_poses)
        readings = odometry.at_each(stamps)
        motions = se2.between(readings[:-1], readings[1:]).reshape(-1, 3)
        covariances = np.array([noise.covariance(motion) for motion in motions]).reshape(-1, 3, 3)
        informations = CLAIMED_SHARE * np.array(self._informations).reshape(-1, 3, 3)
        even = smooth_chain(poses, informations, motions, covariances)
        path = Path()
        path._stamps, path._keyframes, path._informations = self._stamps, self._keyframes, self._informations
        path._relative = list(se2.between(keyframe_poses[self._keyframes], even).reshape(-1, 3))
        return path

    def at_odometry(self, keyframe_poses: Floats, odometry: OdometryHistory) -> tuple[Floats, Floats]:
        """Stamps (m,) and poses (m, 3) at every odometry reading.

        From the scan before it a reading is reached by odometry; what odometry misses up to the next scan is spread
        evenly over the time between the two.
        """
        stamps, poses = self.at_scans(keyframe_poses)
        at = odometry.stamps
        readings = odometry.poses
        scan_odometry = odometry.at_each(stamps)
        before = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(stamps) - 1)
        after = np.minimum(before + 1, len(stamps) - 1)
        bridged = se2.compose(poses[before], se2.between(scan_odometry[before], readings))
        arrived = se2.compose(poses[before], se2.between(scan_odometry[before], scan_odometry[after]))
        missed = poses[after] - arrived
        missed[:, 2] = se2.wrap(missed[:, 2])
        span = stamps[after] - stamps[before]
        part = np.clip((at - stamps[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        result = bridged + part[:, None] * missed
        result[:, 2] = se2.wrap(result[:, 2])
        return at, result
