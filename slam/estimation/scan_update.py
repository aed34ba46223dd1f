"""Update the state by one scan: track the pose, then extend trajectory and map.

`track` finds the scan's pose. `update_map` appends it to the trajectory. If the robot has moved far enough, the scan
becomes a keyframe: its features are associated with landmarks at the pose that these determine, and it is added to the
graph. Whenever the graph has been solved, after some keyframes, the map around the robot is read back and loops are
searched for.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.small_matrices import inverse, is_positive_definite

from ..localisation.match_target import MatchTarget
from ..localisation.tracking import TrackingResult, TrackingStatus
from ..loop_closure.decision import LoopDecision
from ..mapping.data_association import RowAssociation, associate
from ..mapping.keyframes import KeyframeObservations, WallMerge
from ..mapping.local_map import LOCAL_MAP_MARGIN
from ..mapping.mapper import Mapper
from ..odometry.history import MIN_MOTION_TRAVEL, wheel_travel
from ..preprocessing.preprocessor import ProcessedScan
from .keyframe_links import link_revisited, undetermined_share
from .keyframe_motions import motion_since, relative_scan_matches
from .keyframe_selection import familiar_keyframe, is_due, learn_between_keyframes
from .loop_update import search_loop
from .slam_state import RELOCALISED_RADIUS, SlamState
from .stage_timer import StageTimer
from .tracking_checkpoint import Anchor

# Seconds between the two looks of a robot that only stands. Origin: chosen, people have moved on meanwhile; not
# measured.
SECOND_LOOK_TIME = 2.0
# Metres from the last tracked pose above which the local map is taken from around the predicted pose instead.
# Origin: definition, half of LOCAL_MAP_MARGIN: up to there the scans are still matched to the walls that they see.
MAX_UNTRACKED_DISTANCE = 0.5 * LOCAL_MAP_MARGIN


@immutable
class KeyframeUpdate:
    """Changes of the map by one keyframe.

    scan          of the keyframe: the last one, or an earlier one after which nothing is seen
    observations  features of the keyframe and the landmarks they were associated with
    merge         walls that were found to be the same, if any
    loop          decision on a loop hypothesis, if there was one
    superseded    map before a loop was closed; None without a closure
    """

    scan: ProcessedScan
    observations: KeyframeObservations
    merge: WallMerge | None
    loop: LoopDecision | None
    superseded: Mapper | None = None


def track(state: SlamState, scan: ProcessedScan, timer: StageTimer) -> TrackingResult:
    """Estimate the pose of a scan and store it in the state."""
    _follow_prediction(state, scan)
    has_mapped_here = not (state.frozen or state.kidnapped or state.at_part_begin) and state.anchor is not None
    recent = partial(state.local_field.recent, state.mapper.keyframe_poses, state.mapper.travelled)
    target = MatchTarget(
        state.local_map, state.local_field.field, state.mapper.roughness.variances, recent if has_mapped_here else None
    )
    features = scan.features.without_range_bias(state.mapper.graph.range_bias.metres)
    tracking = state.tracker.track(scan.reading, features, target)
    timer.lap("registration")
    if tracking.contradicts_old_map:
        state.local_field.unlink_earlier_passes(state.mapper.travelled)
    untracked = tracking.status in (TrackingStatus.FAILED, TrackingStatus.TENTATIVE)
    state.untracked_scans = [*state.untracked_scans, scan] if untracked else []
    if tracking.status is TrackingStatus.TRACKED:
        state.pose = tracking.pose
        state.slipped = state.slipped or tracking.slipped
    return tracking


def update_map(
    state: SlamState, scan: ProcessedScan, tracking: TrackingResult, timer: StageTimer
) -> KeyframeUpdate | None:
    """Append a tracked scan to the trajectory, and make it a keyframe if the robot has moved far enough.

    If nothing is seen, the last tracked scan becomes a keyframe instead. Returns the changes of the map; None if no
    scan became a keyframe.
    """
    update = None
    _extend_trajectory_by_tentative(state, scan.stamp, tracking)
    tracked = tracking.status is TrackingStatus.TRACKED
    due = tracked and is_due(state, tracking)
    if tracking.status is TrackingStatus.NO_FEATURES:
        update = _add_last_tracked(state, timer)
    if due:
        state.pose = tracking.registration.pose
        state.driven += 0.0 if state.anchor is None else state.spacings(state.anchor_pose, state.pose)
        familiar = familiar_keyframe(state, tracking)
        if familiar is None:
            update = _add_keyframe(state, scan, tracking, timer)
        else:
            _pass_familiar_place(state, familiar, scan, tracking)
    elif tracked:
        learn_between_keyframes(state, scan, tracking)
    extend_trajectory(state, scan.stamp, tracking)
    if tracked:
        state.last_tracked = None if due else (scan, tracking)
    return update


def add_second_look(state: SlamState) -> None:
    """Make the last tracked scan a keyframe at the end, if the robot has only stood where a part of the map begins.

    A wall enters the map when a second keyframe has seen it, so there would be no map. While the robot may still drive
    on, a second look from the same place is no keyframe: with the same errors, it would count them as independent.
    """
    if state.last_tracked is not None and _stands_at_first_keyframe(state, state.last_tracked[0].stamp):
        _add_earlier(state, *state.last_tracked, StageTimer())


def _add_last_tracked(state: SlamState, timer: StageTimer) -> KeyframeUpdate | None:
    """Make the last tracked scan a keyframe if it tells more than odometry of the motion since the last one.

    The robot drives on where nothing is seen. From the last keyframe on, odometry's errors would count up to the next
    scan that shows something; from this one on, only those that no scan has corrected. A robot that has not moved since
    the last keyframe would only see the same again.
    """
    last, state.last_tracked = state.last_tracked, None
    if last is None or state.anchor is None or state.frozen:
        return None
    scan, tracking = last
    motion, covariance = state.dead_reckoning.motion_and_covariance(state.anchor.odometry, scan.reading)
    odometry_tells_more = is_positive_definite(inverse(covariance) - tracking.registration.total_information)
    if odometry_tells_more or wheel_travel(motion) < MIN_MOTION_TRAVEL:
        return None
    return _add_earlier(state, scan, tracking, timer)


def _add_earlier(state: SlamState, scan: ProcessedScan, tracking: TrackingResult, timer: StageTimer) -> KeyframeUpdate:
    """Make an earlier scan a keyframe, the last one that was tracked."""
    state.last_tracked, state.pose = None, tracking.registration.pose
    state.driven += state.spacings(state.anchor_pose, state.pose)
    return _add_keyframe(state, scan, tracking, timer)


def _follow_prediction(state: SlamState, scan: ProcessedScan) -> None:
    """Take the local map from around the predicted pose if the robot has driven on without being tracked."""
    if state.anchor is None or state.kidnapped or state.at_part_begin:
        return
    predicted = state.predict(scan.reading)
    if math.dist(predicted[:2], state.pose[:2]) > MAX_UNTRACKED_DISTANCE:
        state.local_map = state.local_map_at(predicted, RELOCALISED_RADIUS)


def _stands_at_first_keyframe(state: SlamState, stamp: float) -> bool:
    """Return True if the robot has stood for some time where a part of the map begins."""
    is_first = state.mapper.landmarks.parts.firsts[-1] == state.mapper.keyframe_count - 1
    return is_first and not state.frozen and stamp - state.keyframe_stamps[-1] >= SECOND_LOOK_TIME


def _pass_familiar_place(state: SlamState, keyframe: int, scan: ProcessedScan, tracking: TrackingResult) -> None:
    """Set the anchor relative to a keyframe of a familiar place, without changing the map."""
    state.mapper.solve_waiting()
    relative = se2.between(state.mapper.keyframe_poses[keyframe], state.pose)
    state.set_anchor(Anchor(keyframe, relative, tracking.registered_covariance, scan.reading))
    state.kidnapped, state.slipped = state.kidnapped and not state.frozen, False
    if not state.frozen:
        state.mapper.remove_walls_seen_through(state.pose, scan.features.points.xy)
    state.update_local_field()
    state.local_map = state.local_map_at(state.pose, LOCAL_MAP_MARGIN + scan.features.segments.reach())
    state.tracker.correct(state.pose, tracking.registered_covariance)


def _extend_trajectory_by_tentative(state: SlamState, stamp: float, tracking: TrackingResult) -> None:
    """Append the tentative poses before a tracked scan that was found from them; else only odometry would place them.

    Odometry has failed there, so it may lead anywhere. A tentative pose is kept until the next scan confirms it.
    """
    earlier = state.tentative if tracking.from_tentative else []
    state.tentative = [*earlier, (stamp, tracking)] if tracking.status is TrackingStatus.TENTATIVE else []
    if tracking.status is not TrackingStatus.TRACKED or state.anchor is None or state.at_part_begin:
        return
    keyframe = state.anchor.keyframe
    for before, result in earlier:
        relative = se2.between(state.mapper.keyframe_poses[keyframe], result.pose)
        state.trajectory.add(before, keyframe, relative, result.registration.total_information)


def extend_trajectory(state: SlamState, stamp: float, tracking: TrackingResult) -> None:
    """Append the pose of a tracked scan to the trajectory."""
    if state.anchor is None or state.at_part_begin or tracking.status is not TrackingStatus.TRACKED:
        return
    keyframe = state.anchor.keyframe
    relative = se2.between(state.mapper.keyframe_poses[keyframe], state.pose)
    state.trajectory.add(stamp, keyframe, relative, tracking.registration.total_information)


def _associate(state: SlamState, scan: ProcessedScan, tracking: TrackingResult) -> RowAssociation:
    """Associate the scan's features with the local map, and learn the roughness of the walls that are matched."""
    mapper = state.mapper
    corrected = scan.features.without_range_bias(mapper.graph.range_bias.metres)
    association = associate(
        state.pose,
        tracking.registered_covariance,
        corrected.segments,
        corrected.corners,
        state.local_map,
        mapper.roughness.variances,
    )
    mapper.roughness.add_scan(state.pose, corrected.segments, state.local_map, association.walls)
    return association


def _add_keyframe(state: SlamState, scan: ProcessedScan, tracking: TrackingResult, timer: StageTimer) -> KeyframeUpdate:
    """Associate a scan's features and add the keyframe; if the graph is solved, read it back and search for a loop."""
    mapper, features = state.mapper, scan.features
    association = _associate(state, scan, tracking)
    timer.lap("association")
    begins_part = state.at_part_begin
    motion = None if state.anchor is None else motion_since(state, state.anchor, scan.reading, tracking)
    scan_matches = relative_scan_matches(state, scan, tracking)
    observations = mapper.add_keyframe(
        state.pose,
        motion,
        features.segments,
        features.corners,
        association,
        state.local_map,
        scan_matches,
        features.points.xy,
    )
    state.keyframe_stamps.append(scan.stamp)
    state.keyframe_driven.append(state.driven)
    timer.lap("graph")
    state.local_map, merge = mapper.refresh(observations, state.linked_keyframes)
    state.set_anchor(Anchor(mapper.keyframe_count - 1, np.zeros(3), np.zeros((3, 3)), scan.reading))
    state.local_field.add(scan.features, 1.0 if begins_part else undetermined_share(tracking))
    linked = mapper.is_solved and link_revisited(state, scan)
    state.move_to_last_keyframe(observations if linked else None)
    timer.lap("local map")
    decision = search_loop(state) if mapper.is_solved else None
    timer.lap("loops")
    return KeyframeUpdate(scan, observations, merge, decision)
