"""Recognition in a plan: find the motion that moves the map to the plan's frame, or corrects its drift there.

Until the map is in the plan's frame, all submaps of the drive are searched together in the whole plan, and the evidence
of all of them decides; see `recognition.location`. If the pose at the first scan is roughly known, it is enough that
the walls fit the plan there. Later the walls seen recently are searched where the robot may be by its uncertainty, and
two places a submap apart must give the same motion.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..loop_closure.criteria import SUPPORT_RATIO
from ..loop_closure.look import MAX_SQUARED_DISTANCE, SUBMAP_LENGTH, UNMODELLED_SIGMAS
from ..loop_closure.map_descriptor import express_in_frame
from ..loop_closure.relocalisation import MIN_SUBMAP_OVERLAP, MIN_WALLS, MapIndex, index_map, relocalise, submap_of
from ..loop_closure.submap_alignment import align_submap, sample_walls
from ..loop_closure.submap_search import are_distinct
from ..mapping.plan_map import PlanMap
from ..mapping.plan_mapper import plan_mapper
from ..matching.point_matcher import POINT_SPACING
from ..matching.scan_points import surface_points
from ..odometry.correlated_drift import embed_position_covariance, rotate_covariance
from ..recognition.drive_scans import DriveScans
from ..recognition.location import STATED, locate
from ..recognition.scanned_map import ScannedMap, scan_map

if TYPE_CHECKING:
    from ..localisation.local_field import LocalField
    from ..mapping.mapper import Mapper

# Metres of driving whose walls are compared with the plan. Origin: chosen, some rooms; not measured.
RECENT_DISTANCE = 15.0
# Keyframes and metres of driving between two searches. Origin: chosen; not measured.
ATTEMPT_KEYFRAMES = 3
ATTEMPT_DISTANCE = 1.0  # Origin: as ATTEMPT_KEYFRAMES.


@dataclass(frozen=True, slots=True, eq=False)
class PlacedMap:
    """Place of the map in the plan.

    motion      [x, y, heading] into the plan
    keyframe    whose surroundings it was found by
    covariance  (3, 3) of the keyframe's pose in the plan, in the plan's axes
    """

    motion: se2.Pose
    keyframe: int
    covariance: Floats


class PlanRecognition:
    """A plan prepared for recognition, and the motions into it that were found in the last metres."""

    def __init__(self, plan_map: PlanMap, start: se2.Pose | None, start_covariance: Floats) -> None:
        """Prepare a plan for recognition. Raises MapError if it shows too little.

        start  roughly known pose of the base in the plan at the first scan, with its covariance (3, 3)
        """
        self._index = index_map(plan_mapper(plan_map))
        self._map, self._drive = _scan_plan(plan_map, self._index), DriveScans()
        self._start, self._start_covariance = start, start_covariance
        self._found: list[tuple[se2.Pose, float]] = []  # motions into the plan, and the metres driven
        self._last_keyframe, self._last_distance = -ATTEMPT_KEYFRAMES, -ATTEMPT_DISTANCE

    def __deepcopy__(self, memo: dict[int, object]) -> PlanRecognition:
        """Return an independent copy; index and map of the plan are never changed and are shared."""
        other = copy.copy(self)
        other._drive = copy.deepcopy(self._drive)
        other._found = list(self._found)
        return other

    def discard_found(self) -> None:
        """Discard the motions found so far: the plan supports the walls around the robot again."""
        self._found.clear()

    def search(self, mapper: Mapper, local_field: LocalField, anchored: int | None) -> PlacedMap | None:
        """Return the place of the map in the plan if it is certain.

        anchored  last keyframe that saw a wall which the plan supports; None if the map is not in the plan's frame
        """
        travelled = np.asarray(mapper.travelled)
        last, now = mapper.keyframe_count - 1, float(travelled[-1])
        if last - self._last_keyframe < ATTEMPT_KEYFRAMES or now - self._last_distance < ATTEMPT_DISTANCE:
            return None
        self._last_keyframe, self._last_distance = last, now
        recent = (travelled > now - RECENT_DISTANCE) & mapper.landmarks.parts.connected(np.arange(last + 1))
        if anchored is not None:
            return self._confirm(mapper, self._find_admitted(mapper, recent, anchored))
        if self._start is not None:
            aligned = self._align(mapper, recent, self._start, self._start_covariance)
            if aligned is not None:
                return aligned
        return self.find(mapper, local_field) if self._drive.is_due(mapper, _first(mapper)) else None

    def find(self, mapper: Mapper, local_field: LocalField) -> PlacedMap | None:
        """Search for the drive up to now in the whole plan; the result is that of `search`."""
        location = locate(self._drive.take(mapper, local_field, _first(mapper)), self._map, STATED)
        if not location.accepted:
            return None
        member = location.members[-1]
        covariance = rotate_covariance(member.covariance, float(member.pose[2]))
        return PlacedMap(member.motion, member.keyframes[-1], covariance)

    def _confirm(self, mapper: Mapper, found: PlacedMap | None) -> PlacedMap | None:
        """Return a motion that was found if one a submap before was the same, and few others were found since."""
        if found is None:
            return None
        here, now = se2.compose(found.motion, mapper.pose), float(mapper.travelled[-1])
        agrees = [not are_distinct(here, se2.compose(motion, mapper.pose)) for motion, _ in self._found]
        before = [distance for (_, distance), agreeing in zip(self._found, agrees, strict=True) if agreeing]
        self._found.append((found.motion, now))
        certain = bool(before) and now - before[0] >= SUBMAP_LENGTH
        return found if certain and (len(before) + 1) >= SUPPORT_RATIO * (len(agrees) - len(before)) else None

    def _find_admitted(self, mapper: Mapper, observers: np.ndarray, anchored: int) -> PlacedMap | None:
        """Search the walls of some keyframes (k,) in the plan where the robot may be by its uncertainty."""
        found = relocalise(submap_of(mapper, observers), self._index)
        if found is None or not found.verdict.plausible:
            return None
        pose, covariance = mapper.pose, _pose_covariance(mapper, anchored) + np.diag(UNMODELLED_SIGMAS**2)
        errors = [se2.between(pose, se2.compose(motion, pose)) for motion in (found.motion, *found.rivals)]
        near = [bool(error @ np.linalg.solve(covariance, error) < MAX_SQUARED_DISTANCE) for error in errors]
        if sum(near) != 1:
            return None
        motion = (found.motion, *found.rivals)[near.index(True)]
        here, there = se2.compose(motion, pose), np.diag(np.diag(covariance))
        return self._align(mapper, observers, se2.compose(here, se2.inverse(pose)), there)

    def _align(
        self, mapper: Mapper, observers: np.ndarray, start: se2.Pose, start_covariance: Floats
    ) -> PlacedMap | None:
        """Align the walls of some keyframes (k,) with the plan near a motion `start` into the plan.

        start_covariance  (3, 3) of the pose of the last of these keyframes after that motion, in its own frame
        """
        keyframe = int(np.flatnonzero(observers)[-1])
        pose = mapper.keyframe_poses[keyframe]
        observed = express_in_frame(pose, submap_of(mapper, observers).descriptor)
        if len(observed) < MIN_WALLS:
            return None
        guess = se2.compose(start, pose)
        alignment = align_submap(guess, observed, sample_walls(observed), self._index.descriptor)
        motion = se2.compose(alignment.pose, se2.inverse(pose))
        error, covariance = se2.between(guess, alignment.pose), np.linalg.inv(alignment.information)
        near = error @ np.linalg.solve(start_covariance, error) < MAX_SQUARED_DISTANCE
        fits = alignment.length >= MIN_SUBMAP_OVERLAP * float(alignment.observed.sum())
        return PlacedMap(motion, keyframe, np.asarray(covariance)) if near and fits else None


def _first(mapper: Mapper) -> int:
    """Return the first of the last keyframes that are in the connected part of the map, one after the other."""
    connected = mapper.landmarks.parts.connected(np.arange(mapper.keyframe_count))
    return 0 if connected.all() else int(np.flatnonzero(~connected)[-1]) + 1


def _scan_plan(plan_map: PlanMap, index: MapIndex) -> ScannedMap:
    """Prepare a plan to search in: its views take the place of scans."""
    poses = np.array([view.pose for view in plan_map.views])
    return scan_map(index, poses, [surface_points(v.points, v.segments, POINT_SPACING) for v in plan_map.views])


def _pose_covariance(mapper: Mapper, anchored: int) -> Floats:
    """Return the covariance (3, 3) of the last keyframe's pose in the plan, in its own frame."""
    last = mapper.keyframe_count - 1
    drift = embed_position_covariance(mapper.correlated_drift[last] - mapper.correlated_drift[anchored])
    return mapper.graph.keyframe_covariance(last) + rotate_covariance(drift, -float(mapper.pose[2]))
