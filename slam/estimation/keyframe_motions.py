"""Measurements between keyframes that enter the graph: motions by odometry, and scan matches."""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.messages import Odometry
from drivers.small_matrices import inverse

from ..geometry.pose_covariance import covariance_after
from ..geometry.segments import Floats
from ..localisation.match_target import points_of
from ..localisation.tracking import TrackingResult
from ..mapping.keyframes import KeyframeMotion, RelativeScanMatch
from ..matching.point_matcher import INDEPENDENT_SHARE, PointMatch, point_information
from ..matching.shared_points import split_information
from ..preprocessing.preprocessor import ProcessedScan
from .keyframe_selection import learn_motion
from .slam_state import SlamState
from .tracking_checkpoint import Anchor

# Metres, metres, radians: prior of a motion that odometry did not measure. Origin: numerical, weak in a building.
UNMEASURED_MOTION_SIGMAS = np.array([10.0, 10.0, 3.0])
# Information (3, 3) of such a motion. Origin: definition.
UNMEASURED_MOTION_INFORMATION = np.diag(UNMEASURED_MOTION_SIGMAS**-2.0)


def motion_since(state: SlamState, anchor: Anchor, odometry: Odometry, tracking: TrackingResult) -> KeyframeMotion:
    """Return odometry's motion from the anchor to a scan that becomes a keyframe, and learn odometry's errors from it.

    odometry  reading of odometry at the scan

    A robot that was kidnapped since the anchor is where registration has it, with a weak prior; this is stored with the
    keyframe. While odometry is failing, the motion is that of the scans, with the covariance of one that is predicted.
    The states `kidnapped` and `slipped` end here: the next motion begins at the new keyframe.
    """
    registration = tracking.registration
    registered = se2.between(state.anchor_pose, state.pose)
    covariance, correlated_drift = np.diag(UNMEASURED_MOTION_SIGMAS**2), np.zeros((2, 2))
    if state.kidnapped:
        state.kidnapped_keyframes.append(state.mapper.keyframe_count)
        motion = registered
    else:
        model = state.odometry_model
        if state.tracker.odometry_failing:
            model = state.unmeasured_model
            motion, covariance = registered, model.covariance(registered)
        else:
            learn_motion(state, odometry, tracking)
            motion, covariance = state.dead_reckoning.motion_and_covariance(anchor.odometry, odometry)
            if state.slipped:  # odometry is wrong by as much as registration says
                covariance = covariance + np.diag(se2.between(motion, registered) ** 2)
        correlated_drift = model.correlated_drift(motion, registration.total_information)
    state.kidnapped = state.slipped = False
    covariance = covariance + covariance_after(anchor.covariance, motion)
    return KeyframeMotion(anchor.keyframe, se2.compose(anchor.relative, motion), covariance, correlated_drift)


def relative_scan_matches(state: SlamState, scan: ProcessedScan, tracking: TrackingResult) -> list[RelativeScanMatch]:
    """Return the scan matches of a new keyframe with old ones nearby, by its points that are on no known wall.

    Its pose is measured relative to the oldest one by the surfaces that this one has seen, and relative to later ones
    by the other surfaces. If all surfaces counted relative to the oldest one, the errors of the keyframes that have
    placed the newer surfaces would count as measured, too. If all counted relative to the latest one, surfaces that
    were seen long ago would not limit the drift since then.
    """
    field, registration = state.local_field, tracking.registration
    references = field.references(state.pose)
    if not references:
        return []
    points = points_of(scan.features)
    relatives = [se2.between(pose, registration.point_pose) for _, pose in references]
    of_references = [field.points(keyframe) for keyframe, _ in references]
    parts = split_information(registration.point_information, of_references, points, relatives)
    return [_scan_match_with(state, scan, references[row][0], relatives[row], part) for row, part in parts]


def scan_match_by(state: SlamState, scan: ProcessedScan, match: PointMatch, keyframe: int) -> RelativeScanMatch:
    """Return the scan match of the last keyframe with an old one, by the match of its scan with the points there."""
    relative = se2.between(state.mapper.keyframe_poses[keyframe], match.pose)
    return _scan_match_with(state, scan, keyframe, relative, match.information)


def _scan_match_with(
    state: SlamState, scan: ProcessedScan, keyframe: int, relative: se2.Pose, information: Floats
) -> RelativeScanMatch:
    """Return the scan match with a keyframe at a `relative` pose, given its information (3, 3) by points.

    The sweep of the earlier scan is taken to be like that of this one.
    """
    covariance, start_covariance = _noise_covariance(state, scan, information), None
    if not state.mapper.graph.has_point_map(keyframe):
        of_start = point_information(state.local_field.points(keyframe), unbiased=True)
        start_covariance = _noise_covariance(state, scan, of_start)
    return RelativeScanMatch(keyframe, relative, covariance, start_covariance)


def _noise_covariance(state: SlamState, scan: ProcessedScan, information: Floats) -> Floats:
    """Return the covariance (3, 3) of a scan's pose by the noise of its points, if nothing else has measured it.

    information  (3, 3) of the pose by the points
    """
    limited = state.odometry_model.limit_information(INDEPENDENT_SHARE * information, scan.travel)
    return np.asarray(inverse(limited + UNMEASURED_MOTION_INFORMATION))
