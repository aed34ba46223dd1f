"""Distance field around the robot: the points of all keyframes nearby whose relative pose is well known."""

from __future__ import annotations

import copy
import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.segments import Floats
from ..matching.distance_field import DistanceField
from ..matching.line_matcher import ScanFeatures
from ..matching.point_matcher import POINT_SPACING
from ..matching.scan_points import surface_points

# Metres from the middle of the field at which it is built anew. Origin: chosen, a small part of its half width; not
# measured.
MAX_CENTRE_DISTANCE = 8.0
# Metres between keyframes along the drive, or along links between keyframes that saw the same place, up to which their
# relative pose is well known. Origin: chosen, odometry and walls drift by less than a cell in it; not measured.
MAX_PATH = 20.0
# Metres from a keyframe within which a scan shows mostly the same surfaces. Origin: chosen; not measured.
REFERENCE_DISTANCE = 4.0
# Metres by which the pose of a keyframe may have changed since its points were inserted. Origin: chosen, two cells; not
# measured.
MAX_DISPLACEMENT = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class LocalFieldState:
    """What a local field is rebuilt from, besides the points of the keyframes.

    centre          (2,) metres, middle of the field
    links           pairs of keyframes that saw the same place
    inserted        keyframes whose points are in the field, in the order in which they were inserted
    inserted_poses  (k, 3) at which they were inserted
    """

    centre: Floats
    links: Sequence[tuple[int, int]]
    inserted: Sequence[int]
    inserted_poses: Floats


class LocalField:
    """Distance field that grows with the keyframes. Keyframes are numbered from 0."""

    def __init__(self) -> None:
        self.field = DistanceField.empty(np.zeros(2))
        self._points: list[NDArray[np.float32]] = []  # of each keyframe, in its frame
        self._links: list[tuple[int, int]] = []
        self._inserted: list[int] = []  # keyframes whose points are in the field
        self._inserted_poses: Floats = np.zeros((0, 3))  # at which they were inserted
        self._linked = True  # True if other keyframes may have become near

    def __deepcopy__(self, memo: dict[int, object]) -> LocalField:
        """Return an independent copy; the points of keyframes are never changed and are shared."""
        other = LocalField()
        other.field = copy.deepcopy(self.field)
        other._points, other._links, other._linked = list(self._points), list(self._links), self._linked
        other._inserted, other._inserted_poses = list(self._inserted), self._inserted_poses.copy()
        return other

    @property
    def state(self) -> LocalFieldState:
        """State to be saved."""
        return LocalFieldState(self.field.centre, tuple(self._links), tuple(self._inserted), self._inserted_poses)

    def restore(self, state: LocalFieldState) -> None:
        """Continue from a saved state, after the points of all keyframes have been added.

        If no keyframe was inserted, those around the robot are inserted by the next update.
        """
        self.field, self._linked = DistanceField.empty(state.centre), not state.inserted
        self._links, self._inserted = list(state.links), list(state.inserted)
        self._inserted_poses = state.inserted_poses
        for keyframe, pose in zip(self._inserted, self._inserted_poses, strict=True):
            self.field.insert(pose, self.points(keyframe))

    @property
    def inserted(self) -> Sequence[int]:
        """Keyframes whose points are in the field."""
        return self._inserted

    def points(self, keyframe: int) -> Floats:
        """Return the points (p, 4) of a keyframe with their normals, in its frame."""
        return self._points[keyframe].astype(np.float64)

    def add(self, scan: ScanFeatures) -> None:
        """Add the points of the next keyframe. They enter the field with `update`."""
        self._points.append(surface_points(scan.points.all, scan.segments, POINT_SPACING).astype(np.float32))

    def link(self, keyframe: int, other: int) -> None:
        """State that two keyframes saw the same place, so that their relative pose is well known."""
        self._links.append((keyframe, other))
        self._linked = True

    def reference(self, pose: se2.Pose) -> tuple[int, se2.Pose] | None:
        """Return the oldest keyframe near a pose whose points are in the field, and its pose in the field."""
        if not self._inserted:
            return None
        near = np.hypot(*(self._inserted_poses[:, :2] - pose[:2]).T) < REFERENCE_DISTANCE
        oldest = int(np.where(near, self._inserted, len(self._points)).argmin())
        return (self._inserted[oldest], self._inserted_poses[oldest]) if near.any() else None

    def nearest_missing(self, poses: Floats, keyframe: int) -> int | None:
        """Return the keyframe nearest to another one, within REFERENCE_DISTANCE, whose points are not in the field."""
        distances = np.hypot(*(poses[:, :2] - poses[keyframe, :2]).T)
        distances[[*self._inserted, keyframe]] = np.inf
        nearest = int(distances.argmin())
        return nearest if distances[nearest] < REFERENCE_DISTANCE else None

    def update(self, keyframe: int, poses: Floats, travelled: Sequence[float]) -> None:
        """Insert new keyframes; build the field anew if the robot, at `keyframe`, is far from its middle.

        It is also built anew if poses have changed. If keyframes have been linked, those that are near by the links are
        inserted.
        poses      (k, 3) of all keyframes in the map
        travelled  metres driven up to each keyframe
        """
        moved = np.abs(poses[self._inserted, :2] - self._inserted_poses[:, :2]).max(initial=0.0)
        if moved > MAX_DISPLACEMENT or self.field.centre_distance(poses[keyframe]) > MAX_CENTRE_DISTANCE:
            self.field, self._inserted, self._linked = DistanceField.empty(poses[keyframe]), [], True
        if self._linked:
            inserted = set(self._inserted)
            new, self._linked = [k for k in self._near(keyframe, travelled) if k not in inserted], False
        else:
            new = list(range(max(self._inserted, default=-1) + 1, len(self._points)))
        for k in new:
            self.field.insert(poses[k], self.points(k))
        before = self._inserted_poses[: len(self._inserted)]
        self._inserted, self._inserted_poses = self._inserted + new, np.concatenate([before, poses[new]])

    def _near(self, keyframe: int, travelled: Sequence[float]) -> list[int]:
        """Return the keyframes within MAX_PATH of one, along the drive and the links, in ascending order."""
        neighbours: dict[int, list[int]] = {}
        for one, other in self._links:
            neighbours.setdefault(one, []).append(other)
            neighbours.setdefault(other, []).append(one)
        distance, queue = {keyframe: 0.0}, [(0.0, keyframe)]
        while queue:
            path, k = heapq.heappop(queue)
            if path > distance[k]:
                continue
            for other in _adjacent(k, len(self._points), neighbours.get(k, ())):
                step = abs(travelled[other] - travelled[k]) if abs(other - k) == 1 else 0.0
                if path + step < min(distance.get(other, np.inf), MAX_PATH):
                    distance[other] = path + step
                    heapq.heappush(queue, (path + step, other))
        return sorted(distance)


def _adjacent(keyframe: int, count: int, linked: Iterable[int]) -> list[int]:
    """Return the keyframes before and after one, of `count`, and those linked with it."""
    chain = [k for k in (keyframe - 1, keyframe + 1) if 0 <= k < count]
    return [*chain, *linked]
