"""One round of refinement: everything associated again with the map as it is, and solved in batch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats
from ...mapping.data_association import associate
from ...mapping.keyframes import LandmarkIds, Motion
from ...mapping.landmark_ids import assign_landmark_ids
from ...mapping.mapper import Mapper
from ...mapping.wall_merging import merge_everywhere
from ...matching.line_matcher import Registration
from ...odometry.error_model import OdometryModel, fused_motion
from .full_map_matcher import PoseFix
from .landmark_recount import measure, recount
from .scan_history import ScanHistory

# Metres, metres, radians: how well a sighting that passed a familiar place is known relative to a keyframe there.
PASSING_SIGMAS = np.array([0.02, 0.02, 0.01])


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """What came of a round.

    mapper    the map, solved
    motions   (k) to each keyframe from an earlier one
    astray    (n,) sightings that odometry had put in the wrong place
    merged    walls that were found to be another
    changed   features of keyframes that were given to another landmark than before
    """

    mapper: Mapper
    motions: list[Motion | None]
    poses: Floats
    odometry_wrong: NDArray[np.bool_]
    merged: int
    changed: int


def refine_once(
    old: Mapper, history: ScanHistory, model: OdometryModel, poses: Floats, odometry_wrong: NDArray[np.bool_]
) -> Round:
    """Associate what every keyframe of the drive saw with the landmarks of `old`, and solve all from there.

    `poses` (k, 3) are those of the keyframes; `astray` (n,) says which sightings are already known to be.
    """
    new = Mapper.on(old)
    merged = merge_everywhere(new.landmarks, old.graph, new.roughness.variance, new.landmarks.absorb)
    laid, landmark_ids, found_astray = _associate(new, history, poses)
    odometry_wrong = odometry_wrong | found_astray
    placed = np.array([registration.pose for registration in laid])
    placed[0] = poses[0]  # defines the map's frame
    recount(new.landmarks, history, landmark_ids, placed)
    motions: list[Motion | None] = [None]
    motions += [
        motion_to(k, history, model, placed, laid[k].point_information, odometry_wrong)
        for k in range(1, len(history.keyframes))
    ]
    for k, row in enumerate(history.keyframes):
        seen = history.scans[row].features
        new.extend(placed[k], motions[k], seen.segments, seen.corners, landmark_ids[k])
    new.solve()
    solved = new.graph.keyframe_poses(len(history.keyframes))
    measure(new.landmarks, history, landmark_ids, solved, new.roughness.variance)
    return Round(new, motions, solved, odometry_wrong, merged, _changed(old, new))


def _associate(
    mapper: Mapper, history: ScanHistory, poses: Floats
) -> tuple[list[Registration], list[LandmarkIds], NDArray[np.bool_]]:
    """How each keyframe lies on the mapper's landmarks, what it sees of them, and the sightings that were astray."""
    place = PoseFix(history, mapper.landmarks, poses, mapper.roughness.variance)
    everywhere = history.poses(poses)
    laid, landmark_ids, odometry_wrong = [], [], np.zeros(len(history), dtype=bool)
    for k, row in enumerate(history.keyframes):
        seen = history.scans[row].features
        around = place.local_map(int(row), poses[k])
        result = place.match(int(row), everywhere, around)
        registration = result.registration
        association = associate(
            registration.pose,
            place.covariance(registration),
            seen.segments,
            seen.corners,
            around,
            mapper.roughness.variance,
        )
        laid.append(registration)
        odometry_wrong[row] = result.odometry_wrong
        landmark_ids.append(
            assign_landmark_ids(
                mapper.landmarks, k, registration.pose, seen.segments, seen.corners, association, around
            )
        )
    return laid, landmark_ids, odometry_wrong


def motion_to(
    keyframe: int,
    history: ScanHistory,
    model: OdometryModel,
    placed: Floats,
    point_information: Floats,
    odometry_wrong: NDArray[np.bool_],
) -> Motion:
    """The motion to a keyframe from an earlier one, when keyframes are placed at (k, 3)."""
    start, row = history.start_of(keyframe), int(history.keyframes[keyframe])
    anchor, relative = int(history.anchors[start]), history.relative[start]
    claimed, covariance = history.motion(start, row, model, odometry_wrong)
    correlated_drift = history.correlated_drift(start, row, model, odometry_wrong)
    found = se2.between(se2.compose(placed[anchor], relative), placed[keyframe])
    claimed, covariance = fused_motion(claimed, covariance, found, point_information)
    if start != history.keyframes[keyframe - 1]:
        carry = se2.adjoint(se2.inverse(claimed))
        covariance = covariance + carry @ np.diag(PASSING_SIGMAS**2) @ carry.T
    return Motion(anchor, se2.compose(relative, claimed), covariance, correlated_drift)


def _changed(old: Mapper, new: Mapper) -> int:
    """Features that the keyframes of two mappers give to different landmarks."""
    kept = new.landmarks.walls.rows["merged_into"]
    count = 0
    for before, after in zip(old.landmark_ids, new.landmark_ids, strict=True):
        spoken_for = np.where(before.walls >= 0, kept[before.walls], before.walls)
        count += int((spoken_for != after.walls).sum() + (before.corners != after.corners).sum())
    return count
