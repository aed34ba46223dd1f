"""Which scans become keyframes, and what is learned from those between them.

A keyframe adds what its scan sees to the map, and its pose and observations to the graph. Where the map shows all that
the scans see, this is needed rarely: scans between keyframes are tracked all the same. Where a considerable part of a
scan is new, the next scans would have too little to be matched with if it were not added. Odometry's errors are learned
at the smaller one of the two distances everywhere, and walls that are no longer there are noticed at it.
"""

from __future__ import annotations

from drivers import se2

from ..geometry.pose_covariance import covariance_after
from ..geometry.small_matrices import inverse
from ..localisation.tracking import CONDITIONING, TrackingResult
from ..preprocessing.preprocessor import ProcessedScan
from .slam_state import SlamState
from .tracking_checkpoint import Anchor

# Share of a scan's points that lie on known surfaces below which the map lacks a considerable part of what is seen.
# Origin: measured. In offices 10 to 25 % of the scans show less, in mines, halls and outdoors more than half. With
# keyframes at twice the distance everywhere, robots get lost there, while offices are mapped equally well.
MIN_EXPLAINED = 0.9
# Distance of keyframes there, and of the motions that odometry's errors are learned from, as a share of the configured
# one. Origin: chosen, so that two scans in a row share most of what they see; not measured.
CLOSE_SHARE = 0.5


def is_due(state: SlamState, tracking: TrackingResult) -> bool:
    """Return True if a tracked scan should become a keyframe.

    Its predicted pose decides: the scan's own pose would select the scans whose errors lead ahead, and odometry would
    seem to measure too little.
    """
    if state.anchor is None or state.at_part_begin:
        return True
    share = 1.0 if tracking.explained >= MIN_EXPLAINED else CLOSE_SHARE
    return state.spacings(state.anchor_pose, tracking.predicted.pose) > share


def learn_between_keyframes(state: SlamState, scan: ProcessedScan, tracking: TrackingResult) -> None:
    """Learn from a tracked scan that is no keyframe, if the robot has moved by the smaller distance since the last one.

    It shows odometry's errors, and which walls are no longer there.
    """
    if state.anchor is None or state.kidnapped or state.slipped or state.frozen:
        return
    start = state.learned_until or state.anchor
    if state.spacings(state.pose_of(start), tracking.predicted.pose) > CLOSE_SHARE:
        pose = tracking.registration.pose
        learn_motion(state, scan.odometry, tracking)
        state.mapper.count_walls_seen_through(pose, scan.features.points.xy)
        relative = se2.between(state.mapper.keyframe_poses[start.keyframe], pose)
        state.learned_until = Anchor(start.keyframe, relative, tracking.registered_covariance, scan.odometry)


def learn_motion(state: SlamState, odometry: se2.Pose, tracking: TrackingResult) -> None:
    """Learn from the difference between odometry's motion since `learned_until` and the one that the scan shows."""
    start = state.learned_until or state.anchor
    assert start is not None
    measured, by_scan = se2.between(start.odometry, odometry), se2.between(state.pose_of(start), tracking.scan_pose)
    information = tracking.registration.total_information
    if start.covariance.any():
        information = inverse(inverse(information + CONDITIONING) + covariance_after(start.covariance, by_scan))
    state.odometry_model.add_motion(measured, by_scan, information)
