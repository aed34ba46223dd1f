"""Recognition in a plan: find the motion that moves the map to the plan's frame, or corrects its drift there.

All submaps of the drive are searched together, and the evidence of all of them decides; see `recognition.location`.
Until the map is in the plan's frame, they are searched in the whole plan, later where they may be by their uncertainty.
If the pose at the first scan is roughly known, it is enough that the walls fit the plan there.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import Floats
from ..geometry.significance import MOST
from ..geometry.surroundings import INDOOR_RANGE
from ..loop_closure.relative_uncertainty import MAX_SQUARED_DISTANCE, UNMODELLED_SIGMAS
from ..mapping.plan_map import PlanMap
from ..mapping.plan_mapper import plan_mapper
from ..matching.point_matcher import POINT_SPACING
from ..matching.scan_points import surface_points
from ..odometry.correlated_drift import embed_position_covariance, rotate_covariance
from ..recognition.drive_scans import DriveScans
from ..recognition.location import STATED, locate
from ..recognition.map_descriptor import describe_map, express_in_frame
from ..recognition.map_index import MIN_WALLS, MapIndex, index_map
from ..recognition.placements import Uncertainty
from ..recognition.scanned_map import ScannedMap, scan_map
from ..recognition.submap_alignment import align_submap, sample_walls

if TYPE_CHECKING:
    from ..localisation.local_field import LocalField
    from ..mapping.mapper import Mapper

# Metres of driving whose walls are compared with the plan. Origin: definition, two rooms.
RECENT_DISTANCE = INDOOR_RANGE
# Keyframes between two searches. Origin: chosen; not measured.
ATTEMPT_KEYFRAMES = 3
# Share of the observed wall length that must lie on the plan's walls at a roughly known pose.
# Origin: definition, most of it.
MIN_WALLS_ON_PLAN = MOST


@immutable
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
    """A plan prepared for recognition, and the submaps of the drive that are searched for in it."""

    def __init__(self, plan_map: PlanMap, start: se2.Pose | None, start_covariance: Floats) -> None:
        """Prepare a plan for recognition. Raises MapError if it shows too little.

        start  roughly known pose of the base in the plan at the first scan, with its covariance (3, 3)
        """
        self._index = index_map(plan_mapper(plan_map))
        self._map, self._drive = _scan_plan(plan_map, self._index), DriveScans()
        self._start, self._start_covariance = start, start_covariance
        self._last_keyframe = -ATTEMPT_KEYFRAMES

    def __deepcopy__(self, memo: dict[int, object]) -> PlanRecognition:
        """Return an independent copy; index and map of the plan are never changed and are shared."""
        other = copy.copy(self)
        other._drive = copy.deepcopy(self._drive)
        return other

    def discard_submaps(self) -> None:
        """Discard the submaps of the drive: the plan supports the walls around the robot again."""
        self._drive.clear()

    def search(self, mapper: Mapper, local_field: LocalField, last_supported: int | None) -> PlacedMap | None:
        """Return the place of the map in the plan if it is certain.

        last_supported  last keyframe that the plan supports; None if the map is not in the plan's frame yet
        """
        travelled = np.asarray(mapper.travelled)
        last, now = mapper.keyframe_count - 1, float(travelled[-1])
        if last - self._last_keyframe < ATTEMPT_KEYFRAMES:
            return None
        self._last_keyframe = last
        recent = (travelled > now - RECENT_DISTANCE) & mapper.landmarks.parts.connected(np.arange(last + 1))
        if last_supported is None and self._start is not None:
            aligned = self._align(mapper, recent, self._start, self._start_covariance)
            if aligned is not None:
                return aligned
        first = mapper.landmarks.parts.last_run_first if last_supported is None else last_supported + 1
        return self.find(mapper, local_field, last_supported) if self._drive.is_due(mapper, first) else None

    def find(self, mapper: Mapper, local_field: LocalField, last_supported: int | None = None) -> PlacedMap | None:
        """Search for the drive up to now; arguments and result are those of `search`."""
        first, near = mapper.landmarks.parts.last_run_first, None
        if last_supported is not None:
            covariance = pose_covariance_in_plan(mapper, last_supported) + np.diag(UNMODELLED_SIGMAS**2)
            first, near = last_supported + 1, Uncertainty(covariance)
        location = locate(self._drive.take(mapper, local_field, first), self._map, STATED, near)
        if not location.accepted:
            return None
        member = location.members[-1]
        covariance = rotate_covariance(member.covariance, float(member.pose[2]))
        return PlacedMap(member.motion, member.keyframes[-1], covariance)

    def _align(
        self, mapper: Mapper, observers: np.ndarray, start: se2.Pose, start_covariance: Floats
    ) -> PlacedMap | None:
        """Align the walls of some keyframes (k,) with the plan near a motion `start` into the plan.

        start_covariance  (3, 3) of the pose of the last of these keyframes after that motion, in its own frame
        """
        keyframe = int(np.flatnonzero(observers)[-1])
        pose = mapper.keyframe_poses[keyframe]
        observed = express_in_frame(pose, describe_map(mapper.landmarks, mapper.roughness.variances, observers))
        if len(observed) < MIN_WALLS:
            return None
        guess = se2.compose(start, pose)
        alignment = align_submap(guess, observed, sample_walls(observed), self._index.descriptor)
        motion = se2.compose(alignment.pose, se2.inverse(pose))
        error, covariance = se2.between(guess, alignment.pose), np.linalg.inv(alignment.information)
        near = error @ np.linalg.solve(start_covariance, error) < MAX_SQUARED_DISTANCE
        fits = alignment.length >= MIN_WALLS_ON_PLAN * float(alignment.observed.sum())
        return PlacedMap(motion, keyframe, np.asarray(covariance)) if near and fits else None


def _scan_plan(plan_map: PlanMap, index: MapIndex) -> ScannedMap:
    """Prepare a plan to search in: its views take the place of scans."""
    poses = np.array([view.pose for view in plan_map.views])
    return scan_map(index, poses, [surface_points(v.points, v.segments, POINT_SPACING) for v in plan_map.views])


def pose_covariance_in_plan(mapper: Mapper, last_supported: int) -> Floats:
    """Return the covariance (3, 3) of the last keyframe's pose in the plan, in its own frame.

    last_supported  last keyframe that the plan supports: drift counts from there on
    """
    last = mapper.keyframe_count - 1
    drift = embed_position_covariance(mapper.correlated_drift[last] - mapper.correlated_drift[last_supported])
    return mapper.graph.keyframe_covariance(last) + rotate_covariance(drift, -float(mapper.pose[2]))
