"""Which scans become keyframes, and what is learned from those between them.

A keyframe adds what its scan sees to the map, and its pose and observations to the graph. Where the map shows all that
the scans see, this is needed rarely: scans between keyframes are tracked all the same. Where a considerable part of a
scan is new, the next scans would have too little to be matched with if it were not added. Where the robot has been
often enough, no scan becomes a keyframe. Odometry's errors are learned at the smaller one of the two distances
everywhere, and walls that are no longer there are noticed at it.
"""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.messages import Odometry
from drivers.small_matrices import inverse

from ..geometry.degeneracy import weakest_direction
from ..geometry.membership import is_among
from ..geometry.pose_covariance import covariance_after
from ..localisation.tracking import CONDITIONING, TrackingResult
from ..odometry.error_model import MAX_LEARNING_SIGMA
from ..odometry.history import QUARTER_TURN
from ..preprocessing.preprocessor import ProcessedScan
from .slam_state import SlamState
from .tracking_checkpoint import Anchor

# Share of a scan's points that lie on known surfaces below which the map lacks a considerable part of what is seen.
# Origin: measured. In offices 10 to 25 % of the scans show less, in mines, halls and outdoors more than half. With
# keyframes at twice the distance everywhere, robots get lost there, while offices are mapped equally well.
MIN_EXPLAINED = 0.9
# Share of the configured distance of keyframes. It is the distance of keyframes where less than MIN_EXPLAINED is known,
# and of the motions from which odometry's errors are learned. Origin: chosen, so that two scans in a row share most of
# what they see; not measured.
CLOSE_SHARE = 0.5
# A place is familiar after this many visits with keyframes near the robot (metres, radians) if the map explains the
# scan. Origin: chosen so that the graph does not grow while a robot patrols a known building; not measured, but at
# twice the distance a recording of an office is torn by 0.25 m.
FAMILIAR_VISITS = 2
FAMILIAR_DISTANCE = 0.3  # Origin: as FAMILIAR_VISITS.
FAMILIAR_TURN = np.radians(10.0)  # Origin: as FAMILIAR_VISITS.
# Metres: if the features leave the position less certain than this in one direction, as along a corridor, more visits
# are needed: later scans can only improve the position of keyframes. Origin: definition.
FAMILIAR_SIGMA = MAX_LEARNING_SIGMA
FAMILIAR_VISITS_IF_DEGENERATE = 6  # Origin: chosen; not measured.
# Driving elsewhere between two visits, in spacings of keyframes: by default 6.6 m, or 200 degrees of turning. Keyframes
# cannot be counted instead, as they are closer where much is new. Origin: chosen; not measured.
VISIT_GAP = 10.0


def is_due(state: SlamState, tracking: TrackingResult) -> bool:
    """Return True if a tracked scan should become a keyframe.

    The predicted pose decides. By their own poses, scans whose errors point ahead would be selected, and odometry would
    seem to measure too short motions.
    """
    if state.anchor is None or state.at_part_begin:
        return True
    share = 1.0 if tracking.explained >= MIN_EXPLAINED else CLOSE_SHARE
    return state.spacings(state.anchor_pose, tracking.predicted.pose) > share


def familiar_keyframe(state: SlamState, tracking: TrackingResult) -> int | None:
    """Return the nearest keyframe of a familiar place; None if the place is not familiar.

    A place is familiar if it was visited often enough and looks as before. On a frozen map every place is familiar. So
    the graph grows with the size of the building and not with the time spent in it. Only linked keyframes count: others
    are near in an estimate that has drifted, and a pose relative to them would close a loop that nothing confirms.
    """
    mapper = state.mapper
    if state.frozen:
        return int(mapper.keyframes_near(state.pose, np.inf, np.inf)[0])
    if state.kidnapped or state.at_part_begin or tracking.explained < MIN_EXPLAINED:
        return None
    near = mapper.keyframes_near(state.pose, FAMILIAR_DISTANCE, FAMILIAR_TURN)
    near = near[is_among(near, state.local_field.inserted)]
    driven = np.sort([state.keyframe_driven[k] for k in near])
    before = driven[driven < state.driven - VISIT_GAP]  # without those of the current visit
    visits = np.count_nonzero(np.diff(before) > VISIT_GAP) + 1 if len(before) else 0
    observable = weakest_direction(state.pose, tracking.registration.information, FAMILIAR_SIGMA) is None
    return int(near[0]) if visits >= (FAMILIAR_VISITS if observable else FAMILIAR_VISITS_IF_DEGENERATE) else None


def learn_between_keyframes(state: SlamState, scan: ProcessedScan, tracking: TrackingResult) -> None:
    """Learn from a tracked scan that is no keyframe, if the robot has moved by the smaller distance since the last one.

    It shows odometry's errors, and which walls are no longer there; a frozen map keeps its walls.
    """
    if state.anchor is None or state.kidnapped or state.slipped:
        return
    start = state.learned_until or state.anchor
    if state.spacings(state.pose_of(start), tracking.predicted.pose) > CLOSE_SHARE:
        pose = tracking.registration.pose
        learn_motion(state, scan.reading, tracking)
        if not state.frozen:
            state.mapper.count_walls_seen_through(pose, scan.features.points.xy)
        relative = se2.between(state.mapper.keyframe_poses[start.keyframe], pose)
        state.learned_until = Anchor(start.keyframe, relative, tracking.registered_covariance, scan.reading)


def learn_motion(state: SlamState, odometry: Odometry, tracking: TrackingResult) -> None:
    """Learn from the difference between odometry's motion since `learned_until` and the one that the scan shows."""
    start = state.learned_until or state.anchor
    assert start is not None
    measured = se2.between(start.odometry.pose, odometry.pose)
    by_scan = se2.between(state.pose_of(start), tracking.scan_pose)
    information = tracking.registration.total_information
    if start.covariance.any():
        information = inverse(inverse(information + CONDITIONING) + covariance_after(start.covariance, by_scan))
    if abs(measured[2]) <= QUARTER_TURN:  # a larger turn is not certain
        state.odometry_model.add_motion(measured, by_scan, information)
