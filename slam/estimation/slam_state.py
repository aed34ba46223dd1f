"""Where the robot is, the way it came and the map it made: all that sightings change, in one object.

It can be copied, to go back to: a closure that turns out to be wrong is undone by taking the state before it and the
sightings since.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..config import OdometryConfig
from ..geometry.degeneracy import weakest_direction
from ..geometry.segments import Floats
from ..localisation.tracker import MatchTarget, PoseFix, Tracker, TrackingResult, TrackingStatus
from ..loop_closure.closer import LoopCloser, LoopDecision, LoopSearchState, close
from ..mapping.data_association import associate
from ..mapping.keyframes import KeyframeObservations, Merge, Motion
from ..mapping.local_map import empty_local_map
from ..mapping.mapper import REACH_MARGIN, Mapper
from ..mapping.trajectory_builder import TrajectoryBuilder
from ..matching.likelihood_field import KEYFRAMES as RECENT_KEYFRAMES
from ..matching.likelihood_field import RecentPoints
from ..matching.line_matcher import Registration
from ..odometry.error_model import OdometryModel, fused_motion
from ..preprocessing.preprocessor import ProcessedScan
from ..run_statistics import StageTimer

# Metres and radians. On recordings 0.25 to 0.40 m are equally accurate; the time goes with the number of keyframes.
KEYFRAME_DISTANCE = 0.33
KEYFRAME_TURN = np.radians(10.0)
# A place is familiar that keyframes so near were made of on so many visits, where so much of what is seen is known.
FAMILIAR_VISITS, FAMILIAR_DISTANCE, FAMILIAR_TURN, FAMILIAR_EXPLAINED = 2, 0.3, np.radians(10.0), 0.8
# Where walls and corners do not hold the pose, along a corridor, it is better known once later scans are; for that it
# must be a keyframe. That pays for some visits more.
FAMILIAR_SIGMA, FAMILIAR_VISITS_ADRIFT = 0.05, 6  # metres
VISIT_GAP = 20  # keyframes made elsewhere between two visits
UNMEASURED_MOTION_SIGMAS = np.array(
    [10.0, 10.0, 3.0]
)  # metres, metres, radians: what is known of a motion that no wheel made
RELOCALISED_RADIUS = 12.0  # metres of map around a robot that was just found again
UNSEEN_WAY = 1.0  # metres of driving from the last placed scan, from which on the map is looked up anew


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """A place on the way that what comes next is measured from: `relative` to a keyframe, known from there with
    `covariance` (3, 3) in its own frame, and passed when odometry was at `odometry`."""

    keyframe: int
    relative: se2.Pose
    covariance: Floats
    odometry: se2.Pose


@dataclass(frozen=True, slots=True, eq=False)
class TrackingCheckpoint:
    """Where a belief stands on its map and its path: what comes next is measured from here.

    firm               the last pose that is believed, and the odometry's then; `step` led to it, and `fit` is how well
                       the scan lay there
    anchor             None before the first keyframe
    carried            whether the robot has been moved since the anchor without odometry's knowing
    carried_keyframes  that were reached in this way
    """

    firm: PoseFix | None
    step: se2.Pose
    fit: float
    anchor: Anchor | None
    kidnapped: bool
    kidnapped_keyframes: Sequence[int]


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeUpdate:
    """What a keyframe did to the map: what it saw, the walls found to be one and the loop decided on, if any.

    `superseded` is the map before a loop was closed.
    """

    view: KeyframeObservations
    merge: Merge | None
    loop: LoopDecision | None
    superseded: Mapper | None = None


class SlamState:
    """The estimate of everything, changed by one sighting after the other."""

    def __init__(self, config: OdometryConfig, loops: LoopCloser | None = None) -> None:
        self.mapper = Mapper()
        self.odometry_model = OdometryModel(config)
        self.trajectory = TrajectoryBuilder()
        self.keyframe_stamps: list[float] = []
        self.pose = np.zeros(3)  # of the base in the map, at the last sighting
        self.loops = loops or LoopCloser()
        self._tracker = Tracker(self.odometry_model)
        self._local_map = empty_local_map()
        self._recent_points = RecentPoints()
        self._point_field = self._recent_points.field(np.zeros((0, 3)), self.pose)
        self._anchor: Anchor | None = None
        self._kidnapped = False  # whether the robot has been moved since then without odometry's knowing
        self.kidnapped_keyframes: list[int] = []  # that were reached in this way
        self.frozen = False  # see `freeze`
        self.unplaced: list[ProcessedScan] = []  # the last in a row that fit nowhere
        self._searched: tuple[float, int, se2.Pose, Floats] | None = None  # to be borne out by the next scan

    @classmethod
    def restored(
        cls,
        config: OdometryConfig,
        odometry_samples: Floats,
        mapper: Mapper,
        trajectory: TrajectoryBuilder,
        stamps: Sequence[float],
        checkpoint: TrackingCheckpoint,
        looks: LoopSearchState,
        scans: Mapping[int, ProcessedScan],
    ) -> SlamState:
        """The belief that these were of. `stamps` and `sightings` are those of the keyframes; samples are of odometry's
        noise.

        What a closure on probation would fall back to is not remembered: it stays.
        """
        slam_state = cls(config)
        slam_state.odometry_model.take(odometry_samples)
        slam_state.mapper, slam_state.trajectory, slam_state.keyframe_stamps = mapper, trajectory, list(stamps)
        slam_state.loops.recall(looks)
        slam_state._anchor, slam_state._kidnapped = checkpoint.anchor, checkpoint.kidnapped
        slam_state.kidnapped_keyframes = list(checkpoint.kidnapped_keyframes)
        if checkpoint.firm is not None:
            slam_state._tracker.resume(checkpoint.firm, checkpoint.step, checkpoint.fit)
            slam_state.pose = checkpoint.firm.pose
        if mapper.keyframe_count:
            slam_state._look_back(scans)
        return slam_state

    def _look_back(self, scans: Mapping[int, ProcessedScan]) -> None:
        """Have the map around, and the points of keyframes: the last, in a familiar place the nearest."""
        count = self.mapper.keyframe_count
        near = np.arange(count)
        if self.in_familiar_place:
            near = np.sort(self.mapper.keyframes_near(self.pose, np.inf, np.inf)[:RECENT_KEYFRAMES])
        for keyframe in near[-RECENT_KEYFRAMES:].tolist():
            self._recent_points.add(keyframe, scans[keyframe].features.points)
        self._point_field = self._recent_points.field(self.mapper.poses_of(self._recent_points.keyframes), self.pose)
        reach = scans[count - 1].features.segments.reach()
        self._local_map = self.mapper.local_map_at(self.pose, REACH_MARGIN + reach)

    @property
    def checkpoint(self) -> TrackingCheckpoint:
        """Where it stands."""
        tracker, kidnapped = self._tracker, tuple(self.kidnapped_keyframes)
        return TrackingCheckpoint(tracker.firm, tracker.step, tracker.fit, self._anchor, self._kidnapped, kidnapped)

    def settle_on(
        self, mapper: Mapper, trajectory: TrajectoryBuilder, place: PoseFix, scans: Mapping[int, ProcessedScan]
    ) -> None:
        """Take over a map with the same keyframes, which came of a second look, and the path on it.

        `place` is that of the last sighting, `sightings` are those of the keyframes.
        """
        self.mapper, self.trajectory, self.pose = mapper, trajectory, place.pose
        self._tracker.move_to(place.pose, place.odometry)
        self._recent_points = RecentPoints()
        self._look_back(scans)

    def copy(self) -> SlamState:
        """The same estimate, to go back to."""
        return copy.deepcopy(self)

    @property
    def lost(self) -> bool:
        """Whether the robot is not where it was believed to be: too many sightings in a row fit nowhere."""
        return self._tracker.lost

    @property
    def view_changed(self) -> bool:
        """Whether what is seen has changed at a stroke lately: the robot may have been carried away. If not, it is near
        where odometry has it."""
        return self._tracker.view_changed

    @property
    def in_familiar_place(self) -> bool:
        """Whether the robot goes through a familiar place, where the map stays as it is."""
        return self._anchor is not None and self._anchor.keyframe != self.mapper.keyframe_count - 1

    def place(self, scan: ProcessedScan, timer: StageTimer) -> TrackingResult:
        """Find where the robot was."""
        self._keep_up(scan)
        around = MatchTarget(self._local_map, self._point_field, self.mapper.roughness.variance)
        tracking = self._tracker.track(scan.odometry, scan.features, around)
        timer.lap("registration")
        self.unplaced = [*self.unplaced, scan] if tracking.status is TrackingStatus.FAILED else []
        if tracking.status in (TrackingStatus.TRACKED, TrackingStatus.TENTATIVE):
            self.pose = tracking.pose
        return tracking

    def _keep_up(self, scan: ProcessedScan) -> None:
        """Where the robot has driven on without placing a scan, take the map around where odometry has it."""
        there = self.predict(scan.odometry)
        if self._anchor is not None and not self._kidnapped and np.hypot(*(there - self.pose)[:2]) > UNSEEN_WAY:
            self._local_map = self.mapper.local_map_at(there, RELOCALISED_RADIUS)

    def extend(self, scan: ProcessedScan, tracking: TrackingResult, timer: StageTimer) -> KeyframeUpdate | None:
        """Make what was placed part of the path, and let the map grow if the robot has moved on."""
        extension = None
        if tracking.status is TrackingStatus.TRACKED and self._moved_enough():
            familiar = self._familiar_keyframe(tracking)
            if familiar is None:
                extension = self._extend_map(scan, tracking, timer)
            else:
                self._pass_by(familiar, scan, tracking)
        self._hang_on_path(scan.stamp, tracking)
        return extension

    @property
    def _anchor_pose(self) -> se2.Pose:
        """Of the anchor in the map as it stands; where there is none yet, the origin."""
        if self._anchor is None:
            return np.zeros(3)
        return se2.compose(self.mapper.keyframe_poses[self._anchor.keyframe], self._anchor.relative)

    def _moved_enough(self) -> bool:
        moved = se2.between(self._anchor_pose, self.pose)
        far = np.hypot(moved[0], moved[1]) > KEYFRAME_DISTANCE or abs(moved[2]) > KEYFRAME_TURN
        return self._anchor is None or bool(far)

    def _familiar_keyframe(self, tracking: TrackingResult) -> int | None:
        """The nearest of the keyframes at a place that has been visited often enough for nothing new to be learned, and
        where what is seen is what was seen before; None elsewhere. On a frozen map all places are like that.

        So the graph grows with the size of the place and not with the time spent there.
        """
        if self.frozen:
            return int(self.mapper.keyframes_near(self.pose, np.inf, np.inf)[0])
        if self._kidnapped or tracking.registration.overlap_ratio < FAMILIAR_EXPLAINED:
            return None
        near = self.mapper.keyframes_near(self.pose, FAMILIAR_DISTANCE, FAMILIAR_TURN)
        before = np.sort(near[near < self.mapper.keyframe_count - VISIT_GAP])  # this visit does not count
        visits = np.count_nonzero(np.diff(before) > VISIT_GAP) + 1 if len(before) else 0
        held = weakest_direction(self.pose, tracking.registration.information, FAMILIAR_SIGMA) is None
        return int(near[0]) if visits >= (FAMILIAR_VISITS if held else FAMILIAR_VISITS_ADRIFT) else None

    def _pass_by(self, keyframe: int, scan: ProcessedScan, tracking: TrackingResult) -> None:
        """Go through a familiar place: the way goes on from there, the map stays as it is."""
        relative = se2.between(self.mapper.keyframe_poses[keyframe], self.pose)
        self._anchor = Anchor(keyframe, relative, tracking.covariance, scan.odometry)
        self._kidnapped = self._kidnapped and not self.frozen
        if not self.frozen:
            self.mapper.remove_seen_through(self.pose, scan.features.points.all)
        self._local_map = self.mapper.local_map_at(self.pose, REACH_MARGIN + scan.features.segments.reach())
        self._recent_points.add(keyframe, scan.features.points.seen_from(relative))
        self._point_field = self._recent_points.field(self.mapper.poses_of(self._recent_points.keyframes), self.pose)

    def _hang_on_path(self, stamp: float, tracking: TrackingResult) -> None:
        """Make the pose part of the path; one that was searched for, once the next sighting has borne it out."""
        if self._anchor is None:
            return
        keyframe = self._anchor.keyframe
        relative = se2.between(self.mapper.keyframe_poses[keyframe], self.pose)
        place = (stamp, keyframe, relative, tracking.registration.held_by)
        if self._searched is not None and tracking.bears_out_search:
            self.trajectory.add(*self._searched)
        self._searched = place if tracking.status is TrackingStatus.TENTATIVE else None
        if tracking.status is TrackingStatus.TRACKED:
            self.trajectory.add(*place)

    def _extend_map(self, scan: ProcessedScan, tracking: TrackingResult, timer: StageTimer) -> KeyframeUpdate:
        """Make the sighting a keyframe: give its features to landmarks, solve, close loops, see the map around anew."""
        mapper, seen = self.mapper, scan.features
        association = associate(
            self.pose, tracking.covariance, seen.segments, seen.corners, self._local_map, mapper.roughness.variance
        )
        timer.lap("association")
        motion = None if self._anchor is None else self._motion(self._anchor, scan.odometry, tracking.registration)
        view = mapper.add_keyframe(self.pose, motion, seen.segments, seen.corners, association, self._local_map)
        self.keyframe_stamps.append(scan.stamp)
        timer.lap("graph")
        self._local_map, merge = mapper.refresh(view)
        if mapper.remove_seen_through(mapper.pose, seen.points.all):
            self._local_map = mapper.local_map(view)
        self._anchor = Anchor(mapper.keyframe_count - 1, np.zeros(3), np.zeros((3, 3)), scan.odometry)
        self._recent_points.add(mapper.keyframe_count - 1, seen.points)
        self._look_around()
        timer.lap("local map")
        decision = self.loops.search(mapper)
        if decision is not None and decision.verdict.casts_doubt:
            mapper.free_space_evidence.suspend(mapper.travelled[-1])
        timer.lap("loops")
        return KeyframeUpdate(view, merge, decision)

    def _look_around(self) -> None:
        """Take the last keyframe's pose, and the points around it, from the map as it is now."""
        self.pose = self.mapper.pose
        self._point_field = self._recent_points.field(self.mapper.poses_of(self._recent_points.keyframes), self.pose)
        self._tracker.correct(self.pose)

    def freeze(self) -> None:
        """Bring the map to rest, and leave it as it is from now on: only the robot's place on it is looked for."""
        self.mapper.settle()
        self.frozen = True
        self._local_map = self.mapper.local_map_at(self.pose, RELOCALISED_RADIUS)

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """The base is at `pose` in the map when odometry is at `odometry`, wherever it was believed to be."""
        self._tracker.move_to(pose, odometry)
        self.pose, self._kidnapped, self.unplaced = pose, True, []
        self._local_map = self.mapper.local_map_at(pose, RELOCALISED_RADIUS)

    def start_anew(self, odometry: se2.Pose, *, kidnapped: bool) -> None:
        """The base is where odometry has it, as far as that can be known, in a place of which there is no map; it may
        have been `carried` there, or has come by itself."""
        before = self._kidnapped
        self.move_to(self.predict(odometry), odometry)
        self._kidnapped = before or kidnapped
        self._local_map = empty_local_map()

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Where the base is in the map when odometry is at `odometry`, by odometry alone since the last sighting."""
        return self._tracker.predict(odometry)

    def covariance_since(self, keyframe: int, odometry: se2.Pose) -> Floats:
        """(3, 3): of the base's pose when odometry is at `odometry`, by odometry alone since the anchor, relative to a
        keyframe; in the base's frame."""
        assert self._anchor is not None
        anchor, covariance = self._anchor, np.zeros((3, 3))
        if keyframe != anchor.keyframe:
            covariance = self.mapper.relative_covariance(keyframe, anchor.keyframe)
        covariance = _covariance_after(covariance, anchor.relative) + anchor.covariance
        motion = self.odometry_model.corrected(se2.between(anchor.odometry, odometry))
        return _covariance_after(covariance, motion) + self.odometry_model.covariance(motion)

    def close_loop(self, view: KeyframeObservations, decision: LoopDecision) -> LoopDecision:
        """Close a loop that was agreed on right after the keyframe of `view`. If the decision that is returned is a
        rejection after all, this estimate is of no more use: try it on a copy."""
        decision = close(self.mapper, decision)
        if decision.status == "accepted":
            self.loops.forget()
            self.mapper.free_space_evidence.forget()
            self._local_map = self.mapper.local_map(view)
            self._look_around()
        return decision

    def _motion(self, anchor: Anchor, odometry: se2.Pose, found: Registration) -> Motion:
        """The motion since the last anchor; what was found teaches how good odometry is."""
        claimed, actual = se2.between(anchor.odometry, odometry), se2.between(self._anchor_pose, self.pose)
        covariance, correlated_drift = np.diag(UNMEASURED_MOTION_SIGMAS**2), np.zeros((2, 2))
        if self._kidnapped:
            self.kidnapped_keyframes.append(self.mapper.keyframe_count)
            claimed = actual
        else:
            self.odometry_model.learn(claimed, actual, found.held_by)
            claimed = self.odometry_model.corrected(claimed)
            covariance = self.odometry_model.covariance(claimed)
            correlated_drift = self.odometry_model.correlated_drift(claimed, found.held_by)
            claimed, covariance = fused_motion(claimed, covariance, actual, found.point_information)
        self._kidnapped = False
        covariance = covariance + _covariance_after(anchor.covariance, claimed)
        return Motion(anchor.keyframe, se2.compose(anchor.relative, claimed), covariance, correlated_drift)


def _covariance_after(covariance: Floats, motion: se2.Pose) -> Floats:
    """(3, 3): what the covariance of a pose, in its own frame, is after a motion that is known."""
    carry = se2.adjoint(se2.inverse(motion))
    return np.asarray(carry @ covariance @ carry.T)
