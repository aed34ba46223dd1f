"""One iteration of refinement: associate all keyframes again with the present map, and solve in batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.immutable import immutable

from ...geometry.segments import Floats
from ...graph.factors import Factor
from ...localisation.path_distances import PathDistances
from ...mapping.convergence import split_walls
from ...mapping.data_association import associate
from ...mapping.keyframes import KeyframeMotion, LandmarkIds
from ...mapping.landmark_ids import assign_landmark_ids
from ...mapping.mapper import Mapper
from ...mapping.wall_merging import merge_duplicate_walls
from ...odometry.error_model import OdometryModel
from .even_motions import TRACKED_SIGMAS
from .full_map_matcher import FullMapMatcher
from .landmark_recount import recompute_covariances, recount_observations
from .scan_history import ScanHistory


@immutable
class IterationResult:
    """Result of one iteration.

    mapper          the solved map
    poses           (k, 3) of the keyframes
    odometry_wrong  (n,) true for scans at which odometry was found to be wrong
    merged          number of walls merged into others
    changed         number of features associated with another landmark than before
    """

    mapper: Mapper
    poses: Floats
    odometry_wrong: NDArray[np.bool_]
    merged: int
    changed: int


def refine_once(
    old: Mapper,
    history: ScanHistory,
    model: OdometryModel,
    matches: Sequence[Factor],
    poses: Floats,
    path_distances: PathDistances,
    odometry_wrong: NDArray[np.bool_],
) -> IterationResult:
    """Associate the features of all keyframes with the landmarks of `old`, and solve in batch.

    matches         scan matches and loop factors, which stay as they are: they measure one keyframe relative to another
    poses           (k, 3) of the keyframes
    path_distances  between the keyframes
    odometry_wrong  (n,) true for scans at which odometry is already known to be wrong
    """
    new = Mapper.with_landmarks_of(old)
    merged = merge_duplicate_walls(new.landmarks, old.graph, new.roughness.variances, new.landmarks.merge_walls)
    matched, landmark_ids, newly_wrong = _associate(new, history, poses, path_distances, model, odometry_wrong)
    odometry_wrong = odometry_wrong | newly_wrong
    matched[0] = poses[0]  # defines the map's frame
    recount_observations(new.landmarks, history, landmark_ids, matched)
    for k, row in enumerate(history.keyframes):
        motion = motion_to_keyframe(k, history, model, odometry_wrong) if k else None
        features = history.scans[row].features
        new.add_keyframe_with_ids(matched[k], motion, features.segments, features.corners, landmark_ids[k])
    new.graph.add_matches(matches)
    new.solve()
    split_walls(new)
    solved = new.graph.keyframe_poses(len(history.keyframes))
    recompute_covariances(new.landmarks, history, new.landmark_ids, solved, new.roughness.variances)
    return IterationResult(new, solved, odometry_wrong, merged, _count_changes(old, new))


def _associate(
    mapper: Mapper,
    history: ScanHistory,
    poses: Floats,
    path_distances: PathDistances,
    model: OdometryModel,
    known_wrong: NDArray[np.bool_],
) -> tuple[Floats, list[LandmarkIds], NDArray[np.bool_]]:
    """Match each keyframe to the mapper's landmarks and associate its features.

    Returns the poses (k, 3) and landmark ids of the keyframes, and a mask (n,) of scans with wrong odometry.
    """
    bias = mapper.graph.range_bias.metres
    matcher = FullMapMatcher(
        history, mapper.landmarks, poses, path_distances, mapper.roughness.variances, bias, model, known_wrong
    )
    scan_poses = history.scan_poses(poses)
    matched, landmark_ids, odometry_wrong = [], [], np.zeros(len(history), dtype=bool)
    for k, row in enumerate(history.keyframes):
        features = matcher.features(int(row))
        local_map = matcher.local_map(int(row), poses[k])
        match = matcher.match(int(row), scan_poses, local_map)
        registration = match.registration
        association = associate(
            registration.pose,
            matcher.covariance(registration),
            features.segments,
            features.corners,
            local_map,
            mapper.roughness.variances,
        )
        matched.append(registration.pose)
        odometry_wrong[row] = match.odometry_wrong
        landmark_ids.append(
            assign_landmark_ids(
                mapper.landmarks,
                k,
                registration.pose,
                features.segments,
                features.corners,
                association,
                local_map,
                features.points.xy,
            )
        )
    return np.array(matched), landmark_ids, odometry_wrong


def motion_to_keyframe(
    keyframe: int, history: ScanHistory, model: OdometryModel, odometry_wrong: NDArray[np.bool_]
) -> KeyframeMotion:
    """Return odometry's motion to a keyframe from an earlier one.

    `odometry_wrong` (n,) is true for scans at which odometry is known to be wrong.
    """
    start, row = history.odometry_start(keyframe), int(history.keyframes[keyframe])
    origin, relative = int(history.own_keyframes[start]), history.relative[start]
    motion, covariance = history.motion(start, row, model, odometry_wrong)
    correlated_drift = history.correlated_drift(start, row, model, odometry_wrong)
    if start != history.keyframes[keyframe - 1]:
        adjoint = se2.adjoint(se2.inverse(motion))
        covariance = covariance + adjoint @ np.diag(TRACKED_SIGMAS**2) @ adjoint.T
    return KeyframeMotion(origin, se2.compose(relative, motion), covariance, correlated_drift)


def _count_changes(old: Mapper, new: Mapper) -> int:
    """Count the features that the keyframes of two mappers associate with different landmarks."""
    merged_into = new.landmarks.walls.rows["merged_into"]
    count = 0
    for before, after in zip(old.landmark_ids, new.landmark_ids, strict=True):
        walls = np.where(before.walls >= 0, merged_into[before.walls], before.walls)
        count += int((walls != after.walls).sum() + (before.corners != after.corners).sum())
    return count
