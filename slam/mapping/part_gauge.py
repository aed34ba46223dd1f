"""Gauge of a part of the map that is not connected with the rest.

While such a part is mapped, a prior holds its first keyframe where odometry has it, and odometry's motion to it is kept
aside. So all covariances around the robot are relative to the part: with the motion in the graph they would contain its
error, metres and radians if the robot was carried, and gates would admit everything. When the part is joined, left or
stored, the motion takes the place of the prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..geometry.pose_covariance import covariance_after
from ..geometry.segments import Floats, Integers
from ..graph.factor_graph import FIRST_POSE_SIGMAS, FactorGraph
from ..graph.factors import Factor, FactorKind
from ..graph.rebuilding import RigidMotion, rebuild
from ..odometry.correlated_drift import embed_position_covariance
from .keyframes import KeyframeMotion

if TYPE_CHECKING:
    from .mapper import Mapper


class PartGauge:
    """Gauge of the group of the last part of the map.

    motion  odometry's motion to the first keyframe of the group, kept aside while a prior holds this keyframe; None if
            the graph contains the motion, or if the group is that of the first keyframe of all
    """

    def __init__(self, motion: Factor | None = None) -> None:
        self.motion = motion
        # covariances of the keyframe where the motion starts relative to others of its group, which is not mapped now
        self._before: dict[int, Floats] = {}
        # last keyframe, number of updates of the graph, and its covariance relative to the first one of its part
        self._within: tuple[int, int, Floats] | None = None

    @classmethod
    def begin(cls, graph: FactorGraph, keyframe: int, pose: se2.Pose, motion: KeyframeMotion) -> PartGauge:
        """Add the first keyframe of a part to the graph, and return its gauge with odometry's motion to it.

        The correlated drift of this motion is part of its covariance: a join corrects it.
        """
        graph.add_first_keyframe(pose, keyframe)
        covariance = motion.covariance + embed_position_covariance(motion.correlated_drift)
        return cls(Factor(FactorKind.ODOMETRY, motion.start, keyframe, motion.motion, covariance))

    def separates(self, mapper: Mapper, old: int, keyframe: int) -> bool:
        """Return True if only the motion kept aside connects a keyframe of the last part with an old one."""
        if self.motion is None:
            return False
        of_old, of_keyframe = mapper.landmarks.parts.connected(np.array([old, keyframe]))
        return bool(of_keyframe and not of_old)

    def covariance_across(self, mapper: Mapper, old: int, keyframe: int) -> Floats:
        """Return the covariance (3, 3) of a keyframe of the last part relative to one of another group, in its frame.

        It is the sum of three: from the old keyframe to where the motion starts, of the motion, and within the part.
        """
        assert self.motion is not None
        start, first = self.motion.first, self.motion.second
        if old not in self._before:
            self._before[old] = np.zeros((3, 3)) if old == start else mapper.covariances.relative_in_graph(old, start)
        covariance = covariance_after(self._before[old], self.motion.measured) + self.motion.covariance
        if keyframe == first:
            return covariance
        motion = se2.between(mapper.keyframe_poses[first], mapper.keyframe_poses[keyframe])
        updates = mapper.graph.solver.updates
        if self._within is None or self._within[:2] != (keyframe, updates):
            self._within = keyframe, updates, mapper.covariances.relative_in_graph(first, keyframe)
        return covariance_after(covariance, motion) + self._within[2]

    def join(self, mapper: Mapper, old: int, motion: se2.Pose, loops: Sequence[Factor]) -> Integers:
        """Move the group of the last part by a `motion` [x, y, heading] in the map, and connect it.

        It is connected by odometry and by `loops`. Odometry alone, which may know nothing about the motion of a robot
        that was carried, would determine its place too weakly for Cholesky.

        If it is the group of the first keyframe, which stays, the group of the keyframe `old` moves the other way.
        Returns the keyframes that are moved.
        """
        kept = self._forget_motion()
        if kept is None:
            return _rebuild(mapper, old, se2.inverse(motion), lambda _: False, loops)
        return _rebuild(mapper, kept.second, motion, lambda f: _holds(f, kept.second), [kept, *loops])

    def release(self, mapper: Mapper) -> None:
        """Connect the group of the last part by odometry."""
        kept = self._forget_motion()
        if kept is not None:
            _rebuild(mapper, kept.second, np.zeros(3), lambda f: _holds(f, kept.second), [kept])

    def _forget_motion(self) -> Factor | None:
        """Return the motion kept aside, which enters the graph."""
        kept, self.motion = self.motion, None
        self._before, self._within = {}, None
        return kept

    def hold(self, mapper: Mapper) -> None:
        """Hold the group of the last part by a prior if it is not connected with the first part."""
        first = mapper.landmarks.parts.current_first
        if self.motion is not None or not 0 < first < mapper.keyframe_count:
            return
        self.motion = motion_to_part(mapper, first)
        pose, covariance = mapper.graph.keyframe_pose(first), np.diag(FIRST_POSE_SIGMAS**2)
        prior = Factor(FactorKind.POSE_PRIOR, first, first, pose, covariance)
        _rebuild(mapper, first, np.zeros(3), lambda f: _leads_to(f, first), [prior])


def join_groups(mapper: Mapper, old: int, keyframe: int, motion: se2.Pose) -> None:
    """Join the groups of two keyframes of a settled map; a `motion` in the map brings the second into its place.

    If the second is in the group of the first keyframe of all, which stays, the other group moves the other way.
    """
    parts = mapper.landmarks.parts
    if parts.group(keyframe):
        move_group(mapper, keyframe, motion)
    else:
        move_group(mapper, old, se2.inverse(motion))
    parts.join(old, keyframe)


def move_group(mapper: Mapper, keyframe: int, motion: se2.Pose) -> None:
    """Move the group of a keyframe by a `motion` [x, y, heading] in the map; only odometry connects it with others.

    Odometry has failed on the way, by as much as the motion says: as after a slip, that is added to its covariance.
    """
    inside = mapper.landmarks.parts.connected(np.arange(mapper.keyframe_count), keyframe)

    def leads_across(factor: Factor) -> bool:
        return factor.kind is FactorKind.ODOMETRY and bool(inside[factor.first] != inside[factor.second])

    across = [factor for factor in mapper.graph.solver.sorted_factors() if leads_across(factor)]
    poses = np.where(inside[:, None], se2.compose(motion, mapper.keyframe_poses), mapper.keyframe_poses)
    _rebuild(mapper, keyframe, motion, leads_across, [_failed(factor, poses) for factor in across])


def _failed(factor: Factor, poses: Floats) -> Factor:
    """Return odometry's motion with a covariance that contains its error if keyframes are at `poses` (k, 3)."""
    error = se2.between(factor.measured, se2.between(poses[factor.first], poses[factor.second]))
    return replace(factor, covariance=factor.covariance + np.diag(error**2))


def motion_to_part(mapper: Mapper, first: int) -> Factor:
    """Return odometry's motion to the first keyframe of a part of a stored map."""
    return next(f for f in mapper.graph.solver.factors.values() if _leads_to(f, first))


def return_to_odometry(mapper: Mapper, motion: Factor) -> None:
    """Move a group of parts to where odometry's `motion` to its first keyframe leads, which takes its place again."""
    start, now = mapper.keyframe_poses[motion.first], mapper.keyframe_poses[motion.second]
    by_odometry = se2.compose(start, motion.measured)
    shift = se2.compose(by_odometry, se2.inverse(now))
    _rebuild(mapper, motion.second, shift, lambda f: _leads_to(f, motion.second), [motion])


def _holds(factor: Factor, keyframe: int) -> bool:
    """Return True if a factor is the prior of a keyframe."""
    return factor.kind is FactorKind.POSE_PRIOR and factor.first == keyframe


def _leads_to(factor: Factor, keyframe: int) -> bool:
    """Return True if a factor is odometry's motion to a keyframe."""
    return factor.kind is FactorKind.ODOMETRY and factor.second == keyframe


def _rebuild(
    mapper: Mapper, keyframe: int, motion: se2.Pose, remove: Callable[[Factor], bool], add: Sequence[Factor]
) -> Integers:
    """Replace factors of the graph, move the group of a keyframe by a motion in the map, and return its keyframes.

    The covariances of its keyframes' poses are set to that of the last one: they have nearly all of their error in
    common, and only differences of these covariances are used.
    """
    landmarks, parts = mapper.landmarks, mapper.landmarks.parts
    keyframes = np.flatnonzero(parts.connected(np.arange(mapper.keyframe_count), keyframe))
    walls = np.flatnonzero(parts.connected(landmarks.walls.rows["last_seen"], keyframe))
    corners = np.flatnonzero(parts.connected(landmarks.corners.rows["last_seen"], keyframe))
    mapper.graph = rebuild(mapper.graph, RigidMotion(motion, keyframes, walls, corners), remove, add)
    landmarks.move(walls, corners, motion)
    mapper.read_back_all()
    mapper.equalise_covariances(keyframes)
    return keyframes
