"""Where the robot is, the way it came and the map it made: all that sightings change, in one object.

It can be copied, to go back to: a closure that turns out to be wrong is undone by taking the state before it and the
sightings since.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from drivers import se2

from .association import associate
from .config import OdometryConfig
from .front_end import Sighting
from .local_map import empty_local_map
from .loops.closer import LoopCloser, LoopDecision, close
from .mapper import KeyframeView, Mapper, Merge
from .odometry import OdometryNoise, fused_motion
from .path import Path
from .point_field import RecentPoints
from .registration import Registration
from .segments import Floats
from .statistics import Clock
from .tracking import Hold, Placement, Surroundings, Tracker

KEYFRAME_DISTANCE = 0.25  # metres
KEYFRAME_TURN = np.radians(8.0)
CARRIED_SIGMAS = np.array([10.0, 10.0, 3.0])  # metres, metres, radians: what is known of a motion that no wheel made
CARRIED_REACH = 12.0  # metres of map around a robot that was just found again


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """What a keyframe did to the map: what it saw, the walls found to be one and the loop decided on, if any."""

    view: KeyframeView
    merge: Merge | None
    loop: LoopDecision | None


class Belief:
    """The estimate of everything, changed by one sighting after the other."""

    def __init__(self, config: OdometryConfig) -> None:
        self.mapper = Mapper()
        self.odometry_noise = OdometryNoise(config)
        self.path = Path()
        self.keyframe_stamps: list[float] = []
        self.pose = np.zeros(3)  # of the base in the map, at the last sighting
        self.loops = LoopCloser()
        self._tracker = Tracker(self.odometry_noise)
        self._local_map = empty_local_map()
        self._recent_points = RecentPoints()
        self._point_field = self._recent_points.field(np.zeros((0, 3)))
        self._keyframe_odometry = np.zeros(3)
        self._carried = False  # whether the robot has been moved since the last keyframe without odometry's knowing
        self.unplaced: list[Sighting] = []  # the last in a row that fit nowhere
        self._searched: tuple[float, int, se2.Pose] | None = None  # to be borne out by the next scan

    def copy(self) -> Belief:
        """The same estimate, to go back to."""
        return copy.deepcopy(self)

    @property
    def lost(self) -> bool:
        """Whether the robot is not where it was believed to be: too many sightings in a row fit nowhere."""
        return self._tracker.lost

    def take(self, sighting: Sighting, clock: Clock) -> tuple[Placement, Extension | None]:
        """Find where the robot was, and let the map grow if it has moved on."""
        around = Surroundings(self._local_map, self._point_field, self.mapper.flatness.variance)
        placement = self._tracker.track(sighting.odometry, sighting.seen, around)
        clock.lap("registration")
        self.unplaced = [*self.unplaced, sighting] if placement.hold is Hold.NONE else []
        if placement.hold in (Hold.FIRM, Hold.SEARCHED):
            self.pose = placement.pose
        extension = None
        if placement.hold is Hold.FIRM and (self.mapper.keyframe_count == 0 or self._moved_enough()):
            extension = self._extend_map(sighting, placement, clock)
        self._hang_on_path(sighting.stamp, placement)
        return placement, extension

    def _moved_enough(self) -> bool:
        moved = se2.between(self.mapper.pose, self.pose)
        return bool(np.hypot(moved[0], moved[1]) > KEYFRAME_DISTANCE or abs(moved[2]) > KEYFRAME_TURN)

    def _hang_on_path(self, stamp: float, placement: Placement) -> None:
        """Make the pose part of the path; one that was searched for, once the next sighting has borne it out."""
        place = (stamp, self.mapper.keyframe_count - 1, se2.between(self.mapper.pose, self.pose))
        if self._searched is not None and placement.bears_out_search:
            self.path.add(*self._searched)
        self._searched = place if placement.hold is Hold.SEARCHED else None
        if placement.hold is Hold.FIRM:
            self.path.add(*place)

    def _extend_map(self, sighting: Sighting, placement: Placement, clock: Clock) -> Extension:
        """Make the sighting a keyframe: give its features to landmarks, solve, close loops, see the map around anew."""
        mapper, seen = self.mapper, sighting.seen
        association = associate(
            self.pose, placement.covariance, seen.segments, seen.corners, self._local_map, mapper.flatness.variance
        )
        clock.lap("association")
        motion = self._motion(sighting.odometry, placement.registration) if mapper.keyframe_count else None
        view = mapper.add_keyframe(self.pose, motion, seen.segments, seen.corners, association, self._local_map)
        self.keyframe_stamps.append(sighting.stamp)
        clock.lap("graph")
        self._local_map, merge = mapper.refresh(view)
        self._keyframe_odometry = sighting.odometry
        self._recent_points.add(mapper.keyframe_count - 1, seen.points)
        self._look_around()
        clock.lap("local map")
        decision = self.loops.look(mapper)
        clock.lap("loops")
        return Extension(view, merge, decision)

    def _look_around(self) -> None:
        """Take the last keyframe's pose, and the points around it, from the map as it is now."""
        self._point_field = self._recent_points.field(self.mapper.graph.some_poses(self._recent_points.keyframes))
        self.pose = self.mapper.pose
        self._tracker.correct(self.pose)

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """The base is at `pose` in the map when odometry is at `odometry`, wherever it was believed to be."""
        self._tracker.move_to(pose, odometry)
        self.pose, self._carried, self.unplaced = pose, True, []
        self._local_map = self.mapper.local_map_at(pose, CARRIED_REACH)

    def start_anew(self, odometry: se2.Pose) -> None:
        """The base is where odometry has it, as far as that can be known, in a place of which there is no map."""
        self.move_to(self.predict(odometry), odometry)
        self._local_map = empty_local_map()

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Where the base is in the map when odometry is at `odometry`, by odometry alone since the last sighting."""
        return self._tracker.predict(odometry)

    def close_loop(self, view: KeyframeView, decision: LoopDecision) -> LoopDecision:
        """Close a loop that was agreed on right after the keyframe of `view`. If the decision that is returned is a
        rejection after all, this estimate is of no more use: try it on a copy."""
        decision = close(self.mapper, decision)
        if decision.status == "accepted":
            self._local_map = self.mapper.local_map(view)
            self._look_around()
        return decision

    def _motion(self, odometry: se2.Pose, found: Registration) -> tuple[se2.Pose, Floats]:
        """The motion since the last keyframe and its covariance; what was found teaches how good odometry is."""
        claimed, actual = se2.between(self._keyframe_odometry, odometry), se2.between(self.mapper.pose, self.pose)
        if self._carried:
            self._carried = False
            return actual, np.diag(CARRIED_SIGMAS**2)
        self.odometry_noise.learn(claimed, actual)
        return fused_motion(claimed, self.odometry_noise.covariance(claimed), actual, found.point_information)
