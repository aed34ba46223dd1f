"""Link keyframes that saw the same place, so that the scans of one are matched with the points of the other.

A new keyframe is linked with an old one if their relative pose is known well enough for that, and if the new scan fits
the old points where the map has it. What is left between the two poses enters the graph with the link: the scans that
follow are matched with old and new points together, and would keep half of it as a bend of the path.
"""

from __future__ import annotations

import numpy as np

from drivers.small_matrices import inverse

from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats
from ..localisation.prediction_error import PREDICTION_SIGMAS
from ..localisation.tracking import TrackingResult
from ..matching.distance_field import DistanceField
from ..matching.offset_tiles import MAX_CORRECTED_SIGMA, MAX_CORRECTED_TURN_SIGMA
from ..matching.point_matcher import MIN_KNOWN_POINTS, PointMatch, Prediction, match_points
from ..preprocessing.preprocessor import ProcessedScan
from .keyframe_motions import UNMEASURED_MOTION_INFORMATION, scan_match_by
from .slam_state import SlamState

# Metres, metres, radians: standard deviations of the pose of a new scan relative to an old one up to which it is
# matched to both, as Gauss-Newton on the distance field corrects it.
LINK_SIGMAS = np.array([MAX_CORRECTED_SIGMA, MAX_CORRECTED_SIGMA, MAX_CORRECTED_TURN_SIGMA])


def link_revisited(state: SlamState, scan: ProcessedScan) -> bool:
    """Link the last keyframe, made of a scan, with the nearest one that the distance field lacks, if both fit together.

    They do if their relative pose is known so well that Gauss-Newton would correct its error, and if the new scan does
    not fit the old points at another pose. Else the next scans would be pulled from the path to the old points, and
    odometry would seem to have failed, while it is a loop that has to be closed. Returns True if they were linked: the
    map may have moved.
    """
    mapper, last = state.mapper, state.mapper.keyframe_count - 1
    connected = mapper.landmarks.parts.connected(np.arange(last + 1))
    old = state.local_field.nearest_missing(mapper.keyframe_poses, last, connected)
    if old is None:
        return False
    # The bound costs nothing, and is small enough in most places.
    well_known = _is_well_known(mapper.covariances.relative_bound(old, last)) or _is_well_known(
        mapper.covariances.relative(old, last)
    )
    if not well_known:
        return False
    match = _match_around(state, old)
    if match is not None and _is_elsewhere(state, match):
        return False
    state.local_field.link(old, last)
    if match is not None:
        mapper.add_scan_match(scan_match_by(state, scan, match, old))
        mapper.graph.update_until_converged()
        mapper.read_back_all()
    return True


def _match_around(state: SlamState, old: int) -> PointMatch | None:
    """Return the match of the last keyframe with the points around an old one.

    None if too few points are in space that was seen there, or if they fit poorly everywhere, as beside people: then
    the match does not decide if the two are linked.
    """
    poses, last = state.mapper.keyframe_poses, state.mapper.keyframe_count - 1
    around, points = state.local_field.missing_around(old, state.mapper.travelled), state.local_field.points(last)
    field = DistanceField.empty(poses[last])
    field.insert_scans(poses[around], state.local_field.points_of(around))
    possible = Prediction(poses[last], np.diag(LINK_SIGMAS**-2.0))
    match = match_points(field, points, [possible], exhaustive=True)[0]
    return None if match.known < MIN_KNOWN_POINTS or match.poor else match


def _is_elsewhere(state: SlamState, match: PointMatch) -> bool:
    """Return True if the last keyframe fits the points around an old one at another pose than that in the map."""
    expected = Prediction(state.mapper.keyframe_poses[-1], np.diag(PREDICTION_SIGMAS**-2.0))
    return expected.excludes(match.pose)


def _is_well_known(covariance: Floats) -> bool:
    """Return True if scans of two keyframes can be matched, given the covariance (3, 3) of their relative pose."""
    turn = float(np.sqrt(covariance[2, 2]))
    return position_sigma(covariance) < MAX_CORRECTED_SIGMA and turn < MAX_CORRECTED_TURN_SIGMA


def undetermined_share(tracking: TrackingResult) -> float:
    """Return how uncertain scan and odometry leave the motion since the last keyframe.

    It is a ratio of variances: 1 for the largest uncertainty with which keyframes are linked, more beyond it. It is
    zero if the scan alone determines heading and position. The position along a corridor does not count: the surfaces
    there say nothing about it in later scans either.
    """
    by_scan = inverse(tracking.registration.total_information + UNMEASURED_MOTION_INFORMATION)
    across = float(np.linalg.eigvalsh(by_scan[:2, :2])[0])
    turn, share = float(by_scan[2, 2]), 0.0
    if across > MAX_CORRECTED_SIGMA**2:
        share += float(np.linalg.eigvalsh(tracking.registered_covariance[:2, :2])[0]) / MAX_CORRECTED_SIGMA**2
    if turn > MAX_CORRECTED_TURN_SIGMA**2:
        share += float(tracking.registered_covariance[2, 2]) / MAX_CORRECTED_TURN_SIGMA**2
    return share
