"""Landmarks of a settled map as arrays, for the local maps around thousands of poses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled

from ..geometry.angles import axes_of
from ..geometry.segments import Floats, Integers
from .landmark_table import NEVER_REMOVED
from .landmarks import BEHIND_MARGIN, Landmarks
from .local_map import LocalMap

# Value of `removed_at` of landmarks that still exist. Origin: definition, later than any keyframe.
NEVER = np.iinfo(np.int64).max


class SettledLandmarks:
    """Landmarks of a map that does not change any more: `around` is `local_map.landmarks_around`, with less overhead.

    Landmarks that are never active, because they were merged into others, are left out.
    """

    def __init__(self, landmarks: Landmarks) -> None:
        rows, corner_rows = landmarks.walls.rows, landmarks.corners.rows
        self._walls = np.flatnonzero(rows["merged_into"] == np.arange(len(rows)))
        walls = rows[self._walls]
        self._frame, self._covariance = _column(walls, "frame"), _column(walls, "covariance")
        self._axis, self._observations = axes_of(self._frame), _column(walls, "observations")
        self._low, self._high = _column(walls, "low"), _column(walls, "high")
        removed_at = walls["removed_at"]
        self._removed_at = np.where(removed_at == NEVER_REMOVED, NEVER, removed_at)
        self._position, self._headings = _column(corner_rows, "position"), _column(corner_rows, "headings")
        self._corner_covariance = _column(corner_rows, "covariance")
        self._corner_removed_at = _corners_removed_at(landmarks)
        self._parts = landmarks.parts
        self._group = self._parts.groups_of(walls["last_seen"])
        self._corner_group = self._parts.groups_of(corner_rows["last_seen"])

    def around(self, pose: se2.Pose, radius: float, keyframe: int) -> LocalMap:
        """Return the landmarks within `radius` metres of a pose that were active and connected at a keyframe."""
        at = float(pose[0]), float(pose[1])
        group = self._parts.group(keyframe) if len(self._parts) > 1 else 0
        walls = _walls_near(
            at, radius, keyframe, group, self._frame, self._axis, self._low, self._high, self._removed_at, self._group
        )
        corners = _corners_near(
            at, radius, keyframe, group, self._position, self._corner_removed_at, self._corner_group
        )
        return LocalMap(
            walls=self._walls[walls],
            frame=self._frame[walls],
            low=self._low[walls],
            high=self._high[walls],
            wall_covariance=self._covariance[walls],
            observations=self._observations[walls],
            corners=corners,
            position=self._position[corners],
            headings=self._headings[corners],
            corner_covariance=self._corner_covariance[corners],
        )


def _column(rows: NDArray[np.void], name: str) -> Floats:
    return np.ascontiguousarray(rows[name])


def _corners_removed_at(landmarks: Landmarks) -> Integers:
    """Return (m,) the first keyframe after which one of the known walls of a corner did not exist, or NEVER."""
    walls, named = landmarks.walls.rows, landmarks.corners.rows["walls"]
    if not len(walls):
        return np.full(len(named), NEVER)
    kept = np.where(named >= 0, walls["merged_into"][named], -1)
    removed_at = np.where(kept >= 0, walls["removed_at"][kept], NEVER_REMOVED)
    return np.asarray(np.where(removed_at == NEVER_REMOVED, NEVER, removed_at).min(axis=1))


@compiled
def _walls_near(at, radius, keyframe, group, frame, axis, low, high, removed_at, groups):  # type: ignore[no-untyped-def]
    """Return the rows of the walls near the position `at`; see `Landmarks.walls_near`."""
    found, count = np.empty(len(frame), np.int64), 0
    for j in range(len(frame)):
        x, y = at[0] - frame[j, 0], at[1] - frame[j, 1]
        along, ahead = axis[j, 0] * x + axis[j, 1] * y, axis[j, 0] * y - axis[j, 1] * x
        beyond = max(0.0, low[j] - along, along - high[j])
        near = math.hypot(beyond, ahead) < radius and ahead > -BEHIND_MARGIN
        if near and removed_at[j] >= keyframe and groups[j] == group:
            found[count] = j
            count += 1
    return found[:count].copy()


@compiled
def _corners_near(at, radius, keyframe, group, position, removed_at, groups):  # type: ignore[no-untyped-def]
    """Return the rows of the corners near the position `at`; see `Landmarks.corners_near`."""
    found, count = np.empty(len(position), np.int64), 0
    for j in range(len(position)):
        near = math.hypot(position[j, 0] - at[0], position[j, 1] - at[1]) < radius
        if near and removed_at[j] >= keyframe and groups[j] == group:
            found[count] = j
            count += 1
    return found[:count].copy()
