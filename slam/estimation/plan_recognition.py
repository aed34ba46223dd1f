"""Recognition in a plan: find the motion that moves the map to the plan's frame, or corrects its drift there.

Every few metres the walls seen recently are searched in the plan: in the whole of it, or, once the map is in the plan's
frame, where the robot may be by its uncertainty. Two places a submap apart must give the same motion. If the pose at
the first scan is roughly known, it is enough that the walls fit the plan there.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..loop_closure.criteria import SUPPORT_RATIO
from ..loop_closure.join_search import ATTEMPT_DISTANCE, ATTEMPT_KEYFRAMES, RECENT_DISTANCE
from ..loop_closure.look import MAX_SQUARED_DISTANCE, SUBMAP_LENGTH, UNMODELLED_SIGMAS
from ..loop_closure.map_descriptor import express_in_frame
from ..loop_closure.relocalisation import MIN_SUBMAP_OVERLAP, MIN_WALLS, index_map, relocalise, submap_of
from ..loop_closure.submap_alignment import align_submap, sample_walls
from ..loop_closure.submap_search import are_distinct
from ..mapping.plan_map import PlanMap
from ..mapping.plan_mapper import plan_mapper
from ..odometry.correlated_drift import embed_position_covariance, rotate_covariance

if TYPE_CHECKING:
    from ..mapping.mapper import Mapper


class PlanRecognition:
    """A plan prepared for recognition, and the motions into it that were found in the last metres."""

    def __init__(self, plan_map: PlanMap, start: se2.Pose | None, start_covariance: Floats) -> None:
        """Prepare a plan for recognition. Raises MapError if it shows too little.

        start  roughly known pose of the base in the plan at the first scan, with its covariance (3, 3)
        """
        self._index = index_map(plan_mapper(plan_map))
        self._start, self._start_covariance = start, start_covariance
        self._found: list[tuple[se2.Pose, float]] = []  # motions into the plan, and the metres driven
        self._last_keyframe, self._last_distance = -ATTEMPT_KEYFRAMES, -ATTEMPT_DISTANCE

    def __deepcopy__(self, memo: dict[int, object]) -> PlanRecognition:
        """Return an independent copy; the index is never changed and is shared."""
        other = copy.copy(self)
        other._found = list(self._found)
        return other

    def discard_found(self) -> None:
        """Discard the motions found so far: the plan supports the walls around the robot again."""
        self._found.clear()

    def search(self, mapper: Mapper, anchored: int | None) -> tuple[se2.Pose, Floats] | None:
        """Return the motion into the plan, with the covariance (3, 3) of the robot's pose there, if it is certain.

        anchored  last keyframe that saw a wall which the plan supports; None if the map is not in the plan's frame
        """
        travelled = np.asarray(mapper.travelled)
        last, now = mapper.keyframe_count - 1, float(travelled[-1])
        if last - self._last_keyframe < ATTEMPT_KEYFRAMES or now - self._last_distance < ATTEMPT_DISTANCE:
            return None
        self._last_keyframe, self._last_distance = last, now
        recent = (travelled > now - RECENT_DISTANCE) & mapper.landmarks.parts.connected(np.arange(last + 1))
        if self._start is not None and anchored is None:
            aligned = self._align(mapper, recent, self._start, self._start_covariance)
            if aligned is not None:
                return aligned
        found = self.find(mapper, recent) if anchored is None else self._find_admitted(mapper, recent, anchored)
        if found is None:
            return None
        here = se2.compose(found[0], mapper.pose)
        agrees = [not are_distinct(here, se2.compose(motion, mapper.pose)) for motion, _ in self._found]
        before = [distance for (_, distance), agreeing in zip(self._found, agrees, strict=True) if agreeing]
        self._found.append((found[0], now))
        certain = bool(before) and now - before[0] >= SUBMAP_LENGTH
        return found if certain and (len(before) + 1) >= SUPPORT_RATIO * (len(agrees) - len(before)) else None

    def find(self, mapper: Mapper, observers: np.ndarray) -> tuple[se2.Pose, Floats] | None:
        """Search the walls of some keyframes (k,) in the whole plan."""
        found = relocalise(submap_of(mapper, observers), self._index)
        return (found.motion, found.covariance) if found is not None and found.verdict.accepted else None

    def _find_admitted(self, mapper: Mapper, observers: np.ndarray, anchored: int) -> tuple[se2.Pose, Floats] | None:
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
    ) -> tuple[se2.Pose, Floats] | None:
        """Align the walls of some keyframes (k,) with the plan near a motion `start` into the plan.

        start_covariance  (3, 3) of the pose of the last of these keyframes after that motion, in its own frame
        """
        submap = submap_of(mapper, observers)
        observed = express_in_frame(submap.pose, submap.descriptor)
        if len(observed) < MIN_WALLS:
            return None
        guess = se2.compose(start, submap.pose)
        alignment = align_submap(guess, observed, sample_walls(observed), self._index.descriptor)
        motion = se2.compose(alignment.pose, se2.inverse(submap.pose))
        error, covariance = se2.between(guess, alignment.pose), np.linalg.inv(alignment.information)
        near = error @ np.linalg.solve(start_covariance, error) < MAX_SQUARED_DISTANCE
        fits = alignment.length >= MIN_SUBMAP_OVERLAP * float(alignment.observed.sum())
        return (motion, np.asarray(covariance)) if near and fits else None


def _pose_covariance(mapper: Mapper, anchored: int) -> Floats:
    """Return the covariance (3, 3) of the last keyframe's pose in the plan, in its own frame."""
    last = mapper.keyframe_count - 1
    drift = embed_position_covariance(mapper.correlated_drift[last] - mapper.correlated_drift[anchored])
    return mapper.graph.keyframe_covariance(last) + rotate_covariance(drift, -float(mapper.pose[2]))
