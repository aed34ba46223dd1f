"""Keyframes, walls and corners as variables, odometry and observations as factors, solved incrementally by iSAM2.

A wall is a Pose2: a frame on it with x along the wall. An observation is a BetweenFactorPose2 that measures only the
offset across the wall and its direction; its information along the wall is zero. All arithmetic stays in C++.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, L, X

from drivers import se2

from ..segments import Floats

RELINEARIZE_THRESHOLD = 0.01  # metres and radians
RELINEARIZE_SKIP = 10  # updates; a tenth of the cost of relinearising at each update, for the same result
CAUCHY_SCALE = 3.0  # standard deviations at which an observation counts half
ODOMETRY_SCALE = 2.0  # the same for odometry: single readings can be grossly wrong
ALONG_SIGMA = 1.0  # metres; fixes where along a wall its frame lies, once, relative to the keyframe that made it
FIRST_POSE_SIGMA = (1e-3, 1e-3, 1e-4)


def _pose2(pose: se2.Pose) -> gtsam.Pose2:
    return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))


def _array(pose: gtsam.Pose2) -> se2.Pose:
    return np.array([pose.x(), pose.y(), pose.theta()])


class FactorGraph:
    """The map's estimate. Additions are collected and take effect with `update`."""

    def __init__(self) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(RELINEARIZE_THRESHOLD)
        parameters.relinearizeSkip = RELINEARIZE_SKIP
        self._isam = gtsam.ISAM2(parameters)
        self._factors = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._line_kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY_SCALE)
        self._odometry_kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(ODOMETRY_SCALE)
        self.factor_count = 0

    def add_first_keyframe(self, pose: se2.Pose) -> None:
        """The keyframe that defines the map's frame."""
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(FIRST_POSE_SIGMA))
        self._values.insert(X(0), _pose2(pose))
        self._factors.add(gtsam.PriorFactorPose2(X(0), _pose2(pose), noise))

    def add_keyframe(self, index: int, pose: se2.Pose, motion: se2.Pose, covariance: Floats) -> None:
        """A keyframe near `pose`, reached from keyframe index - 1 by the odometry's `motion` with `covariance` (3, 3)."""
        noise = gtsam.noiseModel.Robust.Create(self._odometry_kernel, gtsam.noiseModel.Gaussian.Covariance(covariance))
        self._values.insert(X(index), _pose2(pose))
        self._factors.add(gtsam.BetweenFactorPose2(X(index - 1), X(index), _pose2(motion), noise))

    def add_line(self, line: int, frame: se2.Pose) -> None:
        """A wall whose frame in the map is near `frame`. Its first observation must be made with `anchor=True`."""
        self._values.insert(L(line), _pose2(frame))

    def observe_line(
        self, keyframe: int, line: int, frame: se2.Pose, covariance: Floats, *, anchor: bool = False
    ) -> None:
        """The wall's frame as seen from the keyframe, with the covariance (2, 2) of offset across and direction, at that frame.

        `anchor` fixes the frame along the wall, where nothing else does.
        """
        root = np.zeros((3, 3))
        root[1:, 1:] = np.linalg.cholesky(np.linalg.inv(covariance)).T
        if anchor:
            root[0, 0] = 1.0 / ALONG_SIGMA
        noise = gtsam.noiseModel.Robust.Create(
            self._line_kernel, gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
        )
        self._factors.add(gtsam.BetweenFactorPose2(X(keyframe), L(line), _pose2(frame), noise))

    def update(self) -> None:
        """Bring everything added since the last update into the estimate."""
        self.factor_count += self._factors.size()
        self._isam.update(self._factors, self._values)
        self._factors = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()

    def keyframe_pose(self, index: int) -> se2.Pose:
        return _array(self._isam.calculateEstimatePose2(X(index)))

    def keyframe_poses(self, indices: Iterable[int]) -> Floats:
        return np.array([self.keyframe_pose(k) for k in indices]).reshape(-1, 3)

    def line_frames(self, lines: Sequence[int]) -> Floats:
        return np.array([_array(self._isam.calculateEstimatePose2(L(j))) for j in lines]).reshape(-1, 3)
