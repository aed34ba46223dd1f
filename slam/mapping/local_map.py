"""The local map: landmarks around the robot with covariances relative to it, to which the next scans are matched."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable
from drivers.small_matrices import is_positive_definite, quadratic_form, without_negative_part
from features.normal_limits import NORMAL_LIMIT

from ..geometry.segments import Floats, Integers
from .landmarks import Landmarks

# Metres between a feature and its landmark, however uncertain the pose: two faces of furniture are this far apart.
# Origin: chosen; not measured.
MAX_OFFSET = 0.30
# Radians between a segment and its wall. Origin: chosen; not measured.
MAX_HEADING_DIFFERENCE = math.radians(8.0)
# Square metres and square radians: variances of the offset and heading of a landmark relative to the robot up to which
# features are compared with it. Beyond, the right landmark may lie outside these limits, and one within them may be
# another. Origin: definition.
MAX_PREDICTED_VARIANCE = (MAX_OFFSET / NORMAL_LIMIT) ** 2
MAX_PREDICTED_TURN_VARIANCE = (MAX_HEADING_DIFFERENCE / NORMAL_LIMIT) ** 2  # Origin: as MAX_PREDICTED_VARIANCE.
# Metres by which the local map reaches beyond what the last keyframe observed; the next scans are matched to it.
# Origin: chosen, several times the distance between keyframes; not measured.
LOCAL_MAP_MARGIN = 2.0


@immutable
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
    return _local_map(landmarks, near_walls, near_corners)


def _local_map(landmarks: Landmarks, near_walls: Integers, near_corners: Integers) -> LocalMap:
    """Return the given landmarks, with the covariances of their last observation."""
    # an index array makes contiguous columns: functions would be compiled again for strided ones
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    return LocalMap(
        walls=near_walls,
        frame=walls["frame"][near_walls],
        low=walls["low"][near_walls],
        high=walls["high"][near_walls],
        wall_covariance=walls["covariance"][near_walls],
        observations=walls["observations"][near_walls],
        corners=near_corners,
        position=corners["position"][near_corners],
        headings=corners["headings"][near_corners],
        corner_covariance=corners["covariance"][near_corners],
    )


def local_map_around(
    landmarks: Landmarks, pose: se2.Pose, radius: float, pose_covariances: Floats, linked: Integers | None = None
) -> LocalMap:
    """Return the landmarks within `radius` metres of a pose whose place relative to the last keyframe is well known.

    Others may be recognised by closing a loop only. A landmark's covariance is the sum of that at its last observation
    and of the drift of the robot's pose since then. `pose_covariances` (k, 3, 3) are those of all keyframes, in the
    map's axes.

    linked  keyframes that are linked with the last one; None for all of the map

    Landmarks that neither the linked keyframes nor the last one have seen are left out. A wall counts as seen by all
    keyframes from its first to its last observation. Single landmarks of an earlier pass do not show that the robot is
    there again, even within the uncertainty. Keyframes are linked only if all points of a scan fit there.

    The error of a later pose is that of an earlier one plus what was added in between, so the covariance of their
    difference, the drift, is about the difference of their covariances. Negative eigenvalues, after a loop closure, are
    clamped to zero.
    """
    near_walls, near_corners = landmarks.walls_near(pose, radius), landmarks.corners_near(pose, radius)
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    if linked is not None:
        seen_by = np.sort(np.append(linked, len(pose_covariances) - 1))
        first, last = (walls[name][near_walls] for name in ("first_seen", "last_seen"))
        near_walls = near_walls[_has_any(seen_by, first, last)]
        of_corners = corners["last_seen"][near_corners]
        near_corners = near_corners[_has_any(seen_by, of_corners, of_corners)]
    last_seen = np.concatenate([walls["last_seen"][near_walls], corners["last_seen"][near_corners]])
    drifts = _drifts_since(last_seen, np.argsort(last_seen), pose_covariances)
    of_walls, of_corners = drifts[: len(near_walls)], drifts[len(near_walls) :, :2, :2]
    frame, low, high = (walls[name][near_walls] for name in ("frame", "low", "high"))
    known_walls, wall_drift = _wall_drifts(frame, low, high, pose, of_walls)
    known_corners = np.maximum(of_corners[:, 0, 0], of_corners[:, 1, 1]) < MAX_PREDICTED_VARIANCE
    local_map = _local_map(landmarks, near_walls[known_walls], near_corners[known_corners])
    return replace(
        local_map,
        wall_covariance=local_map.wall_covariance + wall_drift[known_walls],
        corner_covariance=local_map.corner_covariance + of_corners[known_corners],
    )


def _has_any(keyframes: Integers, first: Integers, last: Integers) -> NDArray[np.bool_]:
    """Return (n,) True where any of some keyframes (k,), ascending, is from a `first` one (n,) up to a `last` one."""
    return np.asarray(np.searchsorted(keyframes, first) < np.searchsorted(keyframes, last, side="right"))


@compiled
def _wall_drifts(frame, low, high, pose, drifts):  # type: ignore[no-untyped-def]
    """Return which of n walls have a well known place, and (n, 2, 2) the drift of each.

    That is the covariance of the wall's offset and heading at its frame by the drift (n, 3, 3) of the robot's pose.
    """
    known, of_walls = np.zeros(len(frame), np.bool_), np.empty((len(frame), 2, 2))
    for k in range(len(frame)):
        x, y = frame[k, 0] - pose[0], frame[k, 1] - pose[1]
        c, s = math.cos(frame[k, 2]), math.sin(frame[k, 2])
        # the derivatives by the pose are (-s, c, lever) of the offset and (0, 0, 1) of the heading
        drift, lever = drifts[k], c * x + s * y
        offset, turn = quadratic_form(drift, -s, c, lever), drift[2, 2]
        mixed = c * drift[1, 2] - s * drift[0, 2] + lever * turn
        along = min(max(-(c * x + s * y), low[k]), high[k])  # the point nearest to the robot
        at_robot = offset + 2.0 * along * mixed + along * along * turn
        known[k] = at_robot < MAX_PREDICTED_VARIANCE and turn < MAX_PREDICTED_TURN_VARIANCE
        of_walls[k, 0, 0], of_walls[k, 1, 1] = offset, turn
        of_walls[k, 0, 1] = of_walls[k, 1, 0] = mixed
    return known, of_walls


@compiled
def _drifts_since(keyframes, order, covariances):  # type: ignore[no-untyped-def]
    """Return (n, 3, 3) the growth of the pose covariance since each of some keyframes, see `local_map_around`.

    order  (n,) rows of the keyframes, sorted by them: many landmarks share their last keyframe
    """
    drifts, keyframe, drift = np.empty((len(keyframes), 3, 3)), -1, np.zeros((3, 3))
    for k in order:
        if keyframes[k] != keyframe:
            keyframe = keyframes[k]
            drift = np.empty((3, 3))
            for i in range(3):
                for j in range(3):
                    drift[i, j] = covariances[-1, i, j] - covariances[keyframe, i, j]
            if keyframe < len(covariances) - 1 and not is_positive_definite(drift):
                drift = without_negative_part(drift)
        for i in range(3):
            for j in range(3):
                drifts[k, i, j] = drift[i, j]
    return drifts
