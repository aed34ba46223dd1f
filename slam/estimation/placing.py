"""Place the robot in a map: at a pose that is roughly known, or where a copy of the state was joined with the map."""

from __future__ import annotations

import numpy as np

from drivers import se2
from drivers.messages import Odometry

from ..geometry.nearest_pose import relative_to_nearest
from ..localisation.match_target import MatchTarget
from ..matching.point_matcher import MIN_KNOWN_POINTS, Prediction
from ..preprocessing.preprocessor import ProcessedScan
from .slam_state import SlamState
from .tracking_checkpoint import Anchor

# Metres, metres, radians: standard deviations of a pose that a user sets, for example with the mouse.
# Origin: chosen, those that RViz states, a little wider in heading.
INITIAL_POSE_SIGMAS = np.array([0.5, 0.5, np.radians(20.0)])


def place(state: SlamState, pose: se2.Pose, scan: ProcessedScan) -> bool:
    """Set the base's pose in the map, roughly known, and improve it by matching a scan.

    Returns False if the scan does not fit near it; the state must not be used any more then.
    """
    keyframe, relative = relative_to_nearest(state.mapper.keyframe_poses, pose)
    covariance = np.diag(INITIAL_POSE_SIGMAS**2)
    state.set_anchor(Anchor(keyframe, relative, covariance, scan.reading))
    state.local_field.clear()
    state.update_local_field()
    state.move_to(pose, scan.reading)
    target = MatchTarget(state.local_map, state.local_field.field, state.mapper.roughness.variances)
    features = scan.features.without_range_bias(state.mapper.graph.range_bias.metres)
    match = target.match(features, [Prediction(pose, np.linalg.inv(covariance))], exhaustive=True)
    if match.known < MIN_KNOWN_POINTS or not match.plausible:
        return False
    found = match.points.pose
    relative = se2.between(state.mapper.keyframe_poses[keyframe], found)
    state.set_anchor(Anchor(keyframe, relative, covariance, scan.reading))
    state.move_to(found, scan.reading)
    return True


def relocalise(state: SlamState, joined: SlamState, odometry: Odometry) -> None:
    """Continue where the robot is in a copy of a state, in which it has mapped on and its map was joined.

    Its scans are added to the trajectory, unless the robot was carried and has not been recognised between them and
    now. The copy takes over the errors of odometry learned meanwhile. `odometry` is the present reading of odometry.
    """
    count = state.mapper.keyframe_count
    old_poses, poses = joined.mapper.keyframe_poses[:count], joined.mapper.keyframe_poses
    known = joined.mapper.landmarks.parts.reachable(np.arange(len(poses)))
    rows = joined.trajectory.relative_poses()
    for stamp, keyframe, relative, information in list(zip(*rows, strict=True))[len(state.trajectory) :]:
        if known[keyframe]:
            nearest, pose = relative_to_nearest(old_poses, se2.compose(poses[keyframe], relative))
            state.trajectory.add(float(stamp), nearest, pose, information)
    state.dead_reckoning.model = joined.odometry_model
    nearest, pose = relative_to_nearest(old_poses, joined.pose)
    state.move_to(se2.compose(state.mapper.keyframe_poses[nearest], pose), odometry)
