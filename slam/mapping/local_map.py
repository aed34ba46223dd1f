"""The local map: landmarks around the robot with covariances relative to it, to which the next scans are matched."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats, Integers
from .landmarks import Landmarks

# Metres between a feature and its landmark, however uncertain the pose: two faces of furniture are this far apart.
# Origin: chosen; not measured.
MAX_OFFSET = 0.30
# Radians between a segment and its wall. Origin: chosen; not measured.
MAX_HEADING_DIFFERENCE = math.radians(8.0)
# Square metres and square radians: variances of the offset and heading of a landmark relative to the robot up to which
# features are compared with it. Beyond, the right landmark may lie outside these limits, and one within them may be
# another. Origin: definition, three standard deviations are the limits.
MAX_PREDICTED_VARIANCE = (MAX_OFFSET / 3.0) ** 2
MAX_PREDICTED_TURN_VARIANCE = (MAX_HEADING_DIFFERENCE / 3.0) ** 2  # Origin: as MAX_PREDICTED_VARIANCE.
# Metres by which the local map reaches beyond what the last keyframe observed; the next scans are matched to it.
# Origin: chosen, several times the distance between keyframes; not measured.
LOCAL_MAP_MARGIN = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """n walls and m corners near a keyframe.

    walls              (n,) landmark ids
    frame              (n, 3) in the map: x along the wall, which is seen from y > 0
    low, high          (n,) metres along x, both ends of the observed extent
    wall_covariance    (n, 2, 2) of offset and heading at the frame, relative to the keyframe
    observations       (n,) keyframes that observed the wall
    corners            (m,) landmark ids
    position           (m, 2) in the map
    headings           (m, 2) of the walls before and after the corner, in the map
    corner_covariance  (m, 2, 2) relative to the keyframe, in the map's axes
    """

    walls: Integers
    frame: Floats
    low: Floats
    high: Floats
    wall_covariance: Floats
    observations: Integers
    corners: Integers
    position: Floats
    headings: Floats
    corner_covariance: Floats


def empty_local_map() -> LocalMap:
    """Return a local map without landmarks, as before the first scan."""
    return landmarks_around(Landmarks(), np.zeros(3), 0.0)


def landmarks_around(landmarks: Landmarks, pose: se2.Pose, radius: float, *, keyframe: int | None = None) -> LocalMap:
    """Return the active landmarks within `radius` metres of a pose, with the covariances of their last observation.

    With `keyframe`, landmarks removed at that keyframe or later are included.
    """
    near_walls = landmarks.walls_near(pose, radius, keyframe=keyframe)
    near_corners = landmarks.corners_near(pose, radius, keyframe=keyframe)
    walls, corners = landmarks.walls.rows[near_walls], landmarks.corners.rows[near_corners]
    return LocalMap(
        walls=near_walls,
        frame=_column(walls, "frame"),
        low=_column(walls, "low"),
        high=_column(walls, "high"),
        wall_covariance=_column(walls, "covariance"),
        observations=walls["observations"],
        corners=near_corners,
        position=_column(corners, "position"),
        headings=_column(corners, "headings"),
        corner_covariance=_column(corners, "covariance"),
    )


def _column(rows: NDArray[np.void], name: str) -> Floats:
    """Return a field of landmarks as a contiguous array: functions would be compiled again for a strided one."""
    return np.ascontiguousarray(rows[name])


def local_map_around(landmarks: Landmarks, pose: se2.Pose, radius: float, pose_covariances: list[Floats]) -> LocalMap:
    """Return the landmarks within `radius` metres of a pose whose place relative to the last keyframe is well known.

    Others may be recognised by closing a loop only. A landmark's covariance is the sum of that at its last observation
    and of the drift of the robot's pose since then. `pose_covariances` are those of all keyframes (3, 3), in the map's
    axes.
    """
    around = landmarks_around(landmarks, pose, radius)
    last_seen = (landmarks.walls.rows["last_seen"][around.walls], landmarks.corners.rows["last_seen"][around.corners])
    drift = _drift_since(np.concatenate(last_seen), pose_covariances)
    lever = around.frame[:, :2] - pose[:2]
    c, s = np.cos(around.frame[:, 2]), np.sin(around.frame[:, 2])
    jacobian = np.zeros((len(around.walls), 2, 3))
    jacobian[:, 0] = np.column_stack([-s, c, c * lever[:, 0] + s * lever[:, 1]])
    jacobian[:, 1, 2] = 1.0
    wall_drift = jacobian @ drift[: len(around.walls)] @ jacobian.transpose(0, 2, 1)
    corner_drift = drift[len(around.walls) :, :2, :2]
    along = np.clip(-(c * lever[:, 0] + s * lever[:, 1]), around.low, around.high)  # the point nearest to the robot
    offset = wall_drift[:, 0, 0] + 2 * along * wall_drift[:, 0, 1] + along**2 * wall_drift[:, 1, 1]
    known = (offset < MAX_PREDICTED_VARIANCE) & (wall_drift[:, 1, 1] < MAX_PREDICTED_TURN_VARIANCE)
    known_corners = np.maximum(corner_drift[:, 0, 0], corner_drift[:, 1, 1]) < MAX_PREDICTED_VARIANCE
    return LocalMap(
        walls=around.walls[known],
        frame=around.frame[known],
        low=around.low[known],
        high=around.high[known],
        wall_covariance=(around.wall_covariance + wall_drift)[known],
        observations=around.observations[known],
        corners=around.corners[known_corners],
        position=around.position[known_corners],
        headings=around.headings[known_corners],
        corner_covariance=(around.corner_covariance + corner_drift)[known_corners],
    )


def _drift_since(keyframes: Integers, pose_covariances: list[Floats]) -> Floats:
    """Return (n, 3, 3) the growth of the pose covariance since each of `keyframes`, in the map's axes.

    The error of a later pose is that of an earlier one plus what was added in between, so the covariance of the
    difference is about the difference of the covariances. Negative eigenvalues, after a loop closure, are clamped to
    zero.
    """
    distinct, inverse = np.unique(keyframes, return_inverse=True)  # many landmarks share their last keyframe
    covariances = np.array([pose_covariances[k] for k in distinct]).reshape(-1, 3, 3)
    values, vectors = np.linalg.eigh(pose_covariances[-1] - covariances)
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1))[inverse]
