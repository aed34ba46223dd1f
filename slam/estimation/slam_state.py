"""Plain state of the estimate: map, trajectory, odometry model, tracking and loop search, in one object.

`scan_update` changes it scan by scan. A copy is a checkpoint: a wrong loop closure is undone by returning to the copy
from before it and processing the scans since then again.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from drivers import se2
from drivers.messages import Odometry

from ..config import Config
from ..geometry.segments import Floats, Integers
from ..geometry.surroundings import INDOOR_RANGE
from ..localisation.local_field import LocalField, LocalFieldState
from ..localisation.tracker import Tracker
from ..localisation.tracking import PoseFix, TrackingResult
from ..loop_closure.agreement import LoopAgreement
from ..loop_closure.loop_hypothesis import LoopAgreementState
from ..mapping.convergence import converge
from ..mapping.keyframes import KeyframeObservations
from ..mapping.local_map import LOCAL_MAP_MARGIN, LocalMap, empty_local_map
from ..mapping.mapper import Mapper
from ..mapping.trajectory_builder import TrajectoryBuilder
from ..odometry.dead_reckoning import DeadReckoning
from ..odometry.error_model import OdometryModel
from ..odometry.predicted_motion import PredictedMotionModel, motion_model
from ..odometry.systematic_errors import PERFECT
from ..preprocessing.preprocessor import ProcessedScan
from ..recognition.join_search import JoinSearch
from ..recognition.location import LOST, Expectation
from .plan_prior import PlanPrior
from .tracking_checkpoint import Anchor, TrackingCheckpoint

# Metres of local map around a robot whose pose was set from outside. Origin: definition.
RELOCALISED_RADIUS = INDOOR_RANGE


class SlamState:
    """State of the estimate after a scan.

    mapper               graph, landmarks and keyframes
    trajectory           poses of all tracked scans, relative to keyframes
    dead_reckoning       readings of odometry with their learned errors
    unmeasured_model     errors of motions that are predicted while odometry is failing
    tracker              last pose fix and the other state of tracking
    loops                search for loop closures
    joins                search for the place of a part of the map that is not connected
    keyframe_stamps      seconds
    driven               driving so far in spacings of keyframes, see `spacings`, also where places were familiar
    keyframe_driven      `driven` up to each keyframe
    pose                 (3,) of the base in the map at the last tracked scan
    local_map            landmarks around the robot
    local_field          distance field of the keyframes around the robot
    anchor               start of the motion to the next keyframe; None before the first keyframe
    learned_until        end of the last motion that odometry's errors were learned from; None if that is the anchor
    kidnapped            True if the robot was moved since the anchor without odometry noticing
    slipped              True if odometry has slipped since the anchor, see `TrackingResult`
    kidnapped_keyframes  indices of the keyframes before which it was moved in this way
    frozen               True if only the trajectory is estimated and the map stays as it is
    plan                 plan of the building that supports the map; None without one
    untracked_scans      the last scans in a row that fitted nowhere, or only tentatively
    tentative            stamps and results of the last scans in a row whose tentative poses were found one from another
    last_tracked         last tracked scan and its result; None if it is a keyframe, or nothing has been seen since
    """

    def __init__(self, config: Config, loops: LoopAgreement | None = None) -> None:
        self.config = config
        self.mapper = Mapper()
        self.dead_reckoning = DeadReckoning(motion_model(config.odometry))
        self.unmeasured_model = PredictedMotionModel(config.odometry)
        self.trajectory = TrajectoryBuilder()
        self.tracker = Tracker(self.dead_reckoning)
        self.loops = loops or LoopAgreement()
        self.joins = JoinSearch()
        self.keyframe_stamps: list[float] = []
        self.driven = 0.0
        self.keyframe_driven: list[float] = []
        self.pose = np.zeros(3)
        self.local_map = empty_local_map()
        self.local_field = LocalField()
        self.anchor: Anchor | None = None
        self.learned_until: Anchor | None = None
        self.kidnapped = self.slipped = False
        self.kidnapped_keyframes: list[int] = []
        self.frozen = False
        self.plan: PlanPrior | None = None
        self.untracked_scans: list[ProcessedScan] = []
        self.tentative: list[tuple[float, TrackingResult]] = []
        self.last_tracked: tuple[ProcessedScan, TrackingResult] | None = None

    @classmethod
    def restored(
        cls,
        config: Config,
        odometry_samples: Floats,
        mapper: Mapper,
        trajectory: TrajectoryBuilder,
        stamps: Sequence[float],
        checkpoint: TrackingCheckpoint,
        loops: LoopAgreementState,
        scans: Mapping[int, ProcessedScan],
        joins: Mapping[int, LoopAgreementState] | None = None,
        expected_errors: Floats = PERFECT,
    ) -> SlamState:
        """Restore a state from saved parts.

        `stamps` and `scans` are those of the keyframes, `odometry_samples` the samples of the odometry model, and
        `expected_errors` the errors (6,) that it expected before them. The checkpoints of closures that were still
        monitored are not saved: these closures stay. `joins` are the states of the searches for joins, by group of
        parts.
        """
        state = cls(config)
        state.odometry_model.restore(odometry_samples, expected_errors)
        state.mapper, state.trajectory, state.keyframe_stamps = mapper, trajectory, list(stamps)
        for start, end in pairwise(mapper.keyframe_poses):
            state.keyframe_driven.append(state.driven)
            state.driven += state.spacings(start, end)
        state.keyframe_driven += [state.driven][: len(stamps)]  # of the last one
        state.anchor, state.learned_until = checkpoint.anchor, checkpoint.learned_until
        state.kidnapped = checkpoint.kidnapped
        state.kidnapped_keyframes = list(checkpoint.kidnapped_keyframes)
        if checkpoint.tracker is not None:
            state.tracker.restore(checkpoint.tracker)
            state.pose = checkpoint.tracker.fix.pose
        if mapper.keyframe_count:
            state._rebuild_surroundings(scans, checkpoint.field)
            state.loops.restore(loops, state.local_field)
            state.joins.restore(joins or {}, state.local_field)
        return state

    def replace_odometry(self, config: Config) -> None:
        """Use another source of odometry from now on, whose errors are not known yet."""
        self.config, self.dead_reckoning.model = config, motion_model(config.odometry)
        self.unmeasured_model = PredictedMotionModel(config.odometry)

    @property
    def odometry_model(self) -> OdometryModel:
        """Learned errors of odometry."""
        return self.dead_reckoning.model

    def copy(self) -> SlamState:
        """Return a copy to return to, or to try a change on."""
        return copy.deepcopy(self)

    @property
    def checkpoint(self) -> TrackingCheckpoint:
        """Tracking state to be stored in a session."""
        kidnapped = tuple(self.kidnapped_keyframes)
        return TrackingCheckpoint(
            self.tracker.state, self.local_field.state, self.anchor, self.kidnapped, kidnapped, self.learned_until
        )

    @property
    def lost(self) -> bool:
        """True if too many scans in a row were not tracked."""
        return self.tracker.lost

    @property
    def may_have_been_carried(self) -> bool:
        """True if the view or a gap suggests that the robot was carried."""
        return self.tracker.may_have_been_carried

    @property
    def matched_pose(self) -> se2.Pose | None:
        """Pose of the base in the map at the last scan, tracked or tentative; None if that was not matched."""
        return self.tracker.matched_pose

    @property
    def in_familiar_place(self) -> bool:
        """True while the robot passes a familiar place, where no keyframes are added.

        The anchor is then a pose near a keyframe, with a covariance; an anchor that is a keyframe itself has none.
        """
        return self.anchor is not None and bool(np.count_nonzero(self.anchor.covariance))

    @property
    def anchor_pose(self) -> se2.Pose:
        """Pose of the anchor in the map; the origin if there is no anchor yet."""
        if self.anchor is None:
            return np.zeros(3)
        return self.pose_of(self.anchor)

    def pose_of(self, anchor: Anchor) -> se2.Pose:
        """Return the pose of an anchor in the map."""
        return se2.compose(self.mapper.keyframe_poses[anchor.keyframe], anchor.relative)

    def set_anchor(self, anchor: Anchor) -> None:
        """Set the reference of the next motion, from which odometry's errors are learned as well."""
        self.anchor, self.learned_until = anchor, None

    def predict(self, odometry: Odometry) -> se2.Pose:
        """Return the base's pose in the map, by odometry alone since the last fix."""
        return self.tracker.predict(odometry)

    def move_to(self, pose: se2.Pose, odometry: Odometry) -> None:
        """Set the base's pose in the map at a reading of odometry, regardless of the pose tracked so far."""
        self.tracker.move_to(pose, odometry)
        self.pose, self.kidnapped, self.untracked_scans = pose, True, []
        self.tentative, self.last_tracked = [], None
        self.local_map = self.local_map_at(pose, RELOCALISED_RADIUS)

    def local_map_at(self, pose: se2.Pose, reach: float) -> LocalMap:
        """Return the map within `reach` metres of a pose that scans are compared with."""
        return self.mapper.local_map_at(pose, reach, self.linked_keyframes)

    @property
    def linked_keyframes(self) -> Integers | None:
        """Keyframes in the distance field, whose pose relative to the robot is well known; None for all of the map."""
        return None if self.frozen else self.local_field.inserted

    def begin_part(self, pose: se2.Pose, odometry: Odometry, *, kidnapped: bool, expected: Expectation = LOST) -> None:
        """Continue at a pose in a new part of the map, as the place in the map is not known.

        odometry   reading of odometry at the same time
        kidnapped  true if the robot may have been moved without odometry noticing
        expected   what is known before about the place
        """
        self.kidnapped = self.kidnapped or kidnapped
        self.mapper.begin_part(measured=not self.kidnapped)
        self.mapper.free_space_evidence.clear()
        self.tracker.start_again(pose, odometry)
        self.pose, self.untracked_scans, self.tentative, self.last_tracked = pose, [], [], None
        self.local_map = empty_local_map()
        self.local_field.clear()
        self.loops.clear()
        self.joins = JoinSearch(expected)

    def spacings(self, start: se2.Pose, end: se2.Pose) -> float:
        """Return how far apart two poses are, as a multiple of the configured distance or turn between keyframes."""
        (x, y, turn), mapping = se2.between(start, end).tolist(), self.config.mapping
        return float(max(abs(complex(x, y)) / mapping.keyframe_distance, abs(turn) / mapping.keyframe_turn))

    @property
    def at_part_begin(self) -> bool:
        """True if the next keyframe is the first one of a part of the map."""
        return bool(0 < self.mapper.landmarks.parts.firsts[-1] == self.mapper.keyframe_count)

    def move_to_last_keyframe(self, observations: KeyframeObservations | None) -> None:
        """Set pose, distance field and tracker to the solved pose of the last keyframe.

        With its `observations`, also the local map: what is linked with it has changed.
        """
        self.pose = self.mapper.pose
        self.update_local_field()
        if observations is not None:
            self.local_map = self.mapper.local_map(observations, self.linked_keyframes)
        self.tracker.correct(self.pose)

    def freeze(self) -> None:
        """Settle the map and keep it unchanged from now on."""
        converge(self.mapper)
        self.frozen = True
        self.local_map = self.local_map_at(self.pose, RELOCALISED_RADIUS)

    def replace_map(
        self, mapper: Mapper, trajectory: TrajectoryBuilder, fix: PoseFix, scans: Mapping[int, ProcessedScan]
    ) -> None:
        """Replace the map by one with the same keyframes, for example a refined one, and the trajectory with it.

        `fix` is that of the last scan, `scans` are those of the keyframes. Hypotheses on loops are discarded, which
        were motions in the map before.
        """
        links = replace(self.local_field.state, inserted=(), inserted_poses=np.zeros((0, 3)), successor=None)
        self.mapper, self.trajectory, self.pose, self.last_tracked = mapper, trajectory, fix.pose, None
        self.tracker.move_to(fix.pose, fix.odometry)
        self.loops.clear()
        self._rebuild_surroundings(scans, links)

    def update_local_field(self) -> None:
        """Bring the distance field up to date with the keyframes and their current poses."""
        keyframe = self.mapper.keyframe_count - 1 if self.anchor is None else self.anchor.keyframe
        self.local_field.update(keyframe, self.mapper.keyframe_poses, self.mapper.travelled)

    def _rebuild_surroundings(self, scans: Mapping[int, ProcessedScan], field: LocalFieldState) -> None:
        """Rebuild the distance field from its state and the scans of the keyframes, then the local map.

        If nothing is inserted in that state, the keyframes around the robot are.
        """
        count = self.mapper.keyframe_count
        self.local_field = LocalField()
        for keyframe in range(count):
            self.local_field.add(scans[keyframe].features)
        self.local_field.restore(field)
        if not field.inserted:
            self.update_local_field()
        # a scan between two keyframes is compared with the map around the first one
        centre = self.pose if self.anchor is None or self.kidnapped else self.anchor_pose
        reach = scans[count - 1].features.segments.reach()
        self.local_map = self.local_map_at(centre, LOCAL_MAP_MARGIN + reach)
