"""Distance field around the robot: the points of all keyframes nearby whose relative pose is well known."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.compiled import compiled
from drivers.immutable import immutable

from ..geometry.membership import is_among
from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import SURFACE_DEPTH
from ..matching.distance_field import DistanceField
from ..matching.scan_features import ScanFeatures
from .field_successor import FieldSuccessor, FieldSuccessorState
from .match_target import points_of
from .path_distances import MAX_PATH, PathDistances

# Metres from the middle of the field at which its successor is begun. Origin: chosen, a small part of its half width;
# not measured.
MAX_CENTRE_DISTANCE = 8.0
# Metres from the middle of the field at which it is built anew at once, as the robot is where no successor was built in
# time. Origin: chosen, a multiple of what the robot drives while a successor is built; not measured.
FAR_FROM_CENTRE = 2.0 * MAX_CENTRE_DISTANCE
# Metres from a keyframe within which a scan shows mostly the same surfaces. Origin: chosen; not measured.
REFERENCE_DISTANCE = 4.0
# Metres by which the pose of a keyframe may have changed since its points were inserted. Origin: definition, its
# surfaces would appear twice else.
MAX_DISPLACEMENT = SURFACE_DEPTH


@immutable
class LocalFieldState:
    """What a local field is rebuilt from, besides the points of the keyframes.

    centre          (2,) metres, middle of the field
    links           pairs of keyframes that saw the same place
    gaps            metres by which the path to a keyframe counts as longer, by keyframe; see `LocalField.add`
    inserted        keyframes whose points are in the field, in the order in which they were inserted
    inserted_poses  (k, 3) at which they were inserted
    successor       state of the field that will take its place; None if there is none
    """

    centre: Floats
    links: Sequence[tuple[int, int]]
    gaps: Mapping[int, float]
    inserted: Sequence[int]
    inserted_poses: Floats
    successor: FieldSuccessorState | None = None


@immutable
class _RecentField:
    """Distance field of the last keyframes, and the poses (k, 3) at which each of these was inserted."""

    field: DistanceField
    keyframes: Integers
    poses: Floats

    def has(self, keyframes: Integers, poses: Floats) -> bool:
        """Return True if it is the field of these keyframes at these poses."""
        return np.array_equal(self.keyframes, keyframes) and np.array_equal(self.poses, poses)


class LocalField:
    """Distance field that grows with the keyframes, which are numbered from 0.

    A keyframe is near if it is within MAX_PATH of the robot along the drive and the links. The field has the points of
    the near keyframes.
    """

    def __init__(self) -> None:
        self.field = DistanceField.empty(np.zeros(2))
        self._is_shared = False  # True if a copy may have the same field and successor
        self._freed: LocalFieldState | None = None  # what the field is rebuilt from if its memory has been freed
        self._points: list[NDArray[np.float32]] = []  # of each keyframe, in its frame
        self._links: list[tuple[int, int]] = []
        self._gaps: dict[int, float] = {}
        self._inserted: Integers = np.zeros(0, dtype=np.int64)  # keyframes whose points are in the field
        self._inserted_poses: Floats = np.zeros((0, 3))  # at which they were inserted
        self._successor: FieldSuccessor | None = None  # takes the place of the field once it is complete
        self._may_lack_near = True  # True if the field may lack other keyframes than new ones that are near
        self._may_have_far = False  # True if the field may have keyframes that are near no longer
        self._recent: _RecentField | None = None  # last result of `recent`; scans in a row often need the same

    def __deepcopy__(self, memo: dict[int, object]) -> LocalField:
        """Return an independent copy; the points of keyframes are never changed and are shared.

        The field, which takes some megabytes, is copied when one of both is changed: most copies are not.
        """
        other = LocalField()
        self._is_shared = other._is_shared = True
        other.field, other._freed = self.field, self._freed
        other._points, other._links, other._may_lack_near = list(self._points), list(self._links), self._may_lack_near
        other._gaps = dict(self._gaps)
        other._may_have_far = self._may_have_far
        other._inserted, other._inserted_poses = self._inserted, self._inserted_poses  # replaced, never changed
        other._successor = self._successor
        return other

    @property
    def state(self) -> LocalFieldState:
        """State to be saved."""
        links, inserted = tuple(self._links), tuple(self._inserted.tolist())
        if self._freed is not None:
            centre, successor = self._freed.centre, self._freed.successor
        else:
            centre, successor = self.field.centre, None if self._successor is None else self._successor.state
        return LocalFieldState(centre, links, dict(self._gaps), inserted, self._inserted_poses, successor)

    def restore(self, state: LocalFieldState) -> None:
        """Continue from a saved state, after the points of all keyframes have been added.

        If no keyframe was inserted, those around the robot are inserted by the next update.
        """
        self._links, self._gaps, self._may_lack_near = list(state.links), dict(state.gaps), not state.inserted
        self._inserted, self._inserted_poses = np.array(state.inserted, dtype=np.int64), state.inserted_poses
        self._build(state)

    def _build(self, state: LocalFieldState) -> None:
        """Build the field and its successor from the points that are stated to be in them."""
        self.field = DistanceField.empty(state.centre)
        self.field.insert_scans(self._inserted_poses, self.points_of(self._inserted))
        saved = state.successor
        self._successor = None if saved is None else FieldSuccessor.restored(saved, self._points)
        self._is_shared, self._freed = False, None

    def free(self) -> None:
        """Free the memory of the field. No scan can be matched with it, and no keyframe inserted, until `rebuild`."""
        self._freed = self.state
        self.field, self._successor = DistanceField.empty(np.zeros(2), half_width=0.0), None

    def rebuild(self) -> None:
        """Build the field again if its memory has been freed."""
        if self._freed is not None:
            self._build(self._freed)

    @property
    def inserted(self) -> Integers:
        """Keyframes whose points are in the field."""
        return self._inserted

    def points(self, keyframe: int) -> Floats:
        """Return the points (p, 6) of a keyframe with their normals, in its frame."""
        return self._points[keyframe].astype(np.float64)

    def points_of(self, keyframes: Integers) -> list[NDArray[np.float32]]:
        """Return the points (p, 6) of each of some keyframes with their normals, in its frame, as they are stored."""
        return [self._points[keyframe] for keyframe in keyframes.tolist()]

    def add(self, scan: ScanFeatures, undetermined: float = 0.0) -> None:
        """Add the points of the next keyframe. They enter the field with `update`.

        undetermined  uncertainty of the motion from the keyframe before, relative to the largest one with which two
                      keyframes are in one field. It is 0 if scans determine the motion, and more, for example, in a
                      hall that is wider than the lidar's range. This share of MAX_PATH, at most all of it, is added to
                      the path. Equation: docs/mathematics.md#distance-field
        """
        if undetermined > 0.0:
            self._gaps[len(self._points)] = MAX_PATH * min(1.0, undetermined)
            self._may_have_far = True
        self._points.append(points_of(scan).astype(np.float32))

    def path_distances(self, travelled: Sequence[float]) -> PathDistances:
        """Return the path distances between the keyframes, of which `travelled` has the metres driven up to each."""
        return PathDistances.along(travelled[: len(self._points)], self._gaps, self._links)

    def recent(self, poses: Floats, travelled: Sequence[float]) -> DistanceField:
        """Return a distance field of the keyframes within REFERENCE_DISTANCE of the last one along the drive.

        It is valid up to the next call. For the arguments see `update`.
        """
        keyframes = np.arange(self.path_distances(travelled).first_since(REFERENCE_DISTANCE), len(self._points))
        if self._recent is None or not self._recent.has(keyframes, poses[keyframes]):
            centre = poses[keyframes[-1]]
            field = DistanceField.empty(centre) if self._recent is None else self._recent.field.cleared(centre)
            field.insert_scans(poses[keyframes], self.points_of(keyframes))
            self._recent = _RecentField(field, keyframes, poses[keyframes])
        return self._recent.field

    def unlink_earlier_passes(self, travelled: Sequence[float]) -> None:
        """Remove the links of the keyframes within MAX_PATH of the last one along the drive with earlier ones.

        Takes effect with the next update. The places that the robot has come back to can be linked again, or recognised
        by a loop closure.
        """
        self.unlink(range(self.path_distances(travelled).first_since(MAX_PATH), len(self._points)))

    def is_undetermined(self, since: int, keyframe: int) -> bool:
        """Return True if scans do not determine the whole motion from one keyframe to a later one."""
        return any(since < gap <= keyframe for gap in self._gaps)

    def clear(self) -> None:
        """Empty the field, as where a new part of the map begins: the next keyframe may be anywhere."""
        self.field, self._may_lack_near = DistanceField.empty(self.field.centre), True
        self._is_shared, self._freed = False, None
        self._inserted, self._inserted_poses = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        self._successor = self._recent = None

    def link(self, keyframe: int, other: int) -> None:
        """State that two keyframes saw the same place, so that their relative pose is well known."""
        self._links.append((keyframe, other))
        self._may_lack_near = True

    def unlink(self, keyframes: range) -> None:
        """Remove the links of consecutive keyframes with earlier ones. Takes effect when the field is built anew."""
        first = keyframes.start
        self._links = [(a, b) for a, b in self._links if min(a, b) >= first or max(a, b) not in keyframes]
        self._may_have_far = True

    def references(self, pose: se2.Pose) -> list[tuple[int, se2.Pose]]:
        """Return some keyframes near a pose whose points are in the field, the oldest one first, and their poses in it.

        The age of each is about half of that of the one before, counted in keyframes near, down to the latest one. So
        there are few, and one of about any age. There may be none.
        """
        near = np.flatnonzero(np.hypot(*(self._inserted_poses[:, :2] - pose[:2]).T) < REFERENCE_DISTANCE)
        by_age, chosen, first = near[np.argsort(self._inserted[near])], list[int](), 0
        while first < len(by_age):
            chosen.append(int(by_age[first]))
            first += max(1, (len(by_age) - first) // 2)
        return [(int(self._inserted[row]), self._inserted_poses[row]) for row in chosen]

    def nearest_missing(self, poses: Floats, keyframe: int, connected: NDArray[np.bool_]) -> int | None:
        """Return the nearest keyframe within REFERENCE_DISTANCE of another one whose points are not in the field.

        poses      (k, 3) of all keyframes in the map
        connected  (k,) which of them are in a part of the map that is connected with the other one
        """
        distances = np.where(connected, np.hypot(*(poses[:, :2] - poses[keyframe, :2]).T), np.inf)
        distances[self._inserted] = distances[keyframe] = np.inf
        nearest = int(distances.argmin())
        return nearest if distances[nearest] < REFERENCE_DISTANCE else None

    def missing_around(self, keyframe: int, travelled: Sequence[float]) -> Integers:
        """Return the keyframes within REFERENCE_DISTANCE of one, along the drive, whose points are not in the field."""
        around = self.path_distances(travelled).around(keyframe, REFERENCE_DISTANCE)
        return around[~is_among(around, self._inserted)]

    def update(self, keyframe: int, poses: Floats, travelled: Sequence[float]) -> None:
        """Insert new keyframes; if keyframes have been linked, also those that are near by the links.

        If the robot, at `keyframe`, has left the field's middle, a field around it takes its place after some updates.
        If poses have changed, or keyframes are near no longer, the field is built anew at once.
        poses      (k, 3) of all keyframes in the map
        travelled  metres driven up to each keyframe
        """
        from_centre = self.field.centre_distance(poses[keyframe])
        moved = _largest_shift(poses, self._inserted, self._inserted_poses) > MAX_DISPLACEMENT
        if moved or self._may_have_far or from_centre > FAR_FROM_CENTRE:
            centre = poses[keyframe]
            self.field = DistanceField.empty(centre) if self._is_shared else self.field.cleared(centre)
            self._inserted, self._successor, self._is_shared = self._inserted[:0], None, False
            self._may_lack_near, self._may_have_far = True, False
        else:
            self._end_sharing()
            if from_centre > MAX_CENTRE_DISTANCE and self._successor is None:
                near = self.path_distances(travelled).near([keyframe])
                self._successor = FieldSuccessor.around(poses[keyframe], near)
        new = self._new_keyframes(keyframe, travelled)
        self.field.insert_scans(poses[new], self.points_of(new))
        before = self._inserted_poses[: len(self._inserted)]
        self._inserted = np.concatenate([self._inserted, new])
        self._inserted_poses = np.concatenate([before, poses[new]])
        if self._successor is not None:
            self._successor.add(new)
            self._build_successor(self._successor, poses)

    def _end_sharing(self) -> None:
        """Copy the field and its successor if a copy of this object may have them too, as they are to be changed."""
        if self._is_shared:
            self.field, self._successor = copy.deepcopy(self.field), copy.deepcopy(self._successor)
            self._is_shared = False

    def _new_keyframes(self, keyframe: int, travelled: Sequence[float]) -> Integers:
        """Return the keyframes to be inserted: those added since the last update, and those near by new links."""
        if not self._may_lack_near:
            return np.arange(int(self._inserted.max(initial=-1)) + 1, len(self._points))
        near, self._may_lack_near = self.path_distances(travelled).near([keyframe]), False
        return near[~is_among(near, self._inserted)]

    def _build_successor(self, successor: FieldSuccessor, poses: Floats) -> None:
        """Insert the next keyframes into the successor, which takes the place of the field if it is complete then."""
        successor.step(poses, self._points)
        if successor.complete:
            self.field, self._inserted, self._inserted_poses = successor.field, successor.keyframes, successor.poses
            self._successor = None


@compiled
def _largest_shift(poses, keyframes, former):  # type: ignore[no-untyped-def]
    """Return the largest change of a coordinate (metres) of some keyframes between `former` poses and those of all."""
    largest = 0.0
    for k in range(len(keyframes)):
        for axis in range(2):
            largest = max(largest, abs(poses[keyframes[k], axis] - former[k, axis]))
    return largest
