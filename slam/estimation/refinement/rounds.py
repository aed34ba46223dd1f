"""One round of refinement: everything associated again with the map as it is, and solved in batch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...geometry.segments import Floats
from ...mapping.data_association import associate
from ...mapping.keyframes import Motion, LandmarkIds
from ...mapping.landmark_ids import assign_landmark_ids
from ...mapping.mapper import Mapper
from ...mapping.wall_merging import merge_everywhere
from ...matching.line_matcher import Registration
from ...odometry.error_model import OdometryModel, fused_motion
from .drive import Drive
from .placing import PoseFix
from .renaming import measure, recount

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
    astray: NDArray[np.bool_]
    merged: int
    changed: int


def refine_once(old: Mapper, drive: Drive, model: OdometryModel, poses: Floats, astray: NDArray[np.bool_]) -> Round:
    """Associate what every keyframe of the drive saw with the landmarks of `old`, and solve all from there.

    `poses` (k, 3) are those of the keyframes; `astray` (n,) says which sightings are already known to be.
    """
    new = Mapper.on(old)
    merged = merge_everywhere(new.landmarks, old.graph, new.flatness.variance, new.landmarks.absorb)
    laid, names, found_astray = _associate(new, drive, poses)
    astray = astray | found_astray
    placed = np.array([registration.pose for registration in laid])
    placed[0] = poses[0]  # defines the map's frame
    recount(new.landmarks, drive, names, placed)
    motions: list[Motion | None] = [None]
    motions += [
        motion_to(k, drive, model, placed, laid[k].point_information, astray) for k in range(1, len(drive.keyframes))
    ]
    for k, row in enumerate(drive.keyframes):
        seen = drive.sightings[row].seen
        new.extend(placed[k], motions[k], seen.segments, seen.corners, names[k])
    new.solve()
    solved = new.graph.keyframe_poses(len(drive.keyframes))
    measure(new.landmarks, drive, names, solved, new.flatness.variance)
    return Round(new, motions, solved, astray, merged, _changed(old, new))


def _associate(
    mapper: Mapper, drive: Drive, poses: Floats
) -> tuple[list[Registration], list[LandmarkIds], NDArray[np.bool_]]:
    """How each keyframe lies on the mapper's landmarks, what it sees of them, and the sightings that were astray."""
    place = PoseFix(drive, mapper.landmarks, poses, mapper.flatness.variance)
    everywhere = drive.poses(poses)
    laid, names, astray = [], [], np.zeros(len(drive), dtype=bool)
    for k, row in enumerate(drive.keyframes):
        seen = drive.sightings[row].seen
        around = place.local_map(int(row), poses[k])
        result = place.lay(int(row), everywhere, around)
        registration = result.registration
        association = associate(
            registration.pose,
            place.covariance(registration),
            seen.segments,
            seen.corners,
            around,
            mapper.flatness.variance,
        )
        laid.append(registration)
        astray[row] = result.astray
        names.append(
            assign_landmark_ids(mapper.landmarks, k, registration.pose, seen.segments, seen.corners, association, around)
        )
    return laid, names, astray


def motion_to(
    keyframe: int,
    drive: Drive,
    model: OdometryModel,
    placed: Floats,
    point_information: Floats,
    astray: NDArray[np.bool_],
) -> Motion:
    """The motion to a keyframe from an earlier one, when keyframes are placed at (k, 3)."""
    start, row = drive.start_of(keyframe), int(drive.keyframes[keyframe])
    anchor, relative = int(drive.anchors[start]), drive.relative[start]
    claimed, covariance = drive.motion(start, row, model, astray)
    adrift = drive.adrift(start, row, model, astray)
    found = se2.between(se2.compose(placed[anchor], relative), placed[keyframe])
    claimed, covariance = fused_motion(claimed, covariance, found, point_information)
    if start != drive.keyframes[keyframe - 1]:
        carry = se2.adjoint(se2.inverse(claimed))
        covariance = covariance + carry @ np.diag(PASSING_SIGMAS**2) @ carry.T
    return Motion(anchor, se2.compose(relative, claimed), covariance, adrift)


def _changed(old: Mapper, new: Mapper) -> int:
    """Features that the keyframes of two mappers give to different landmarks."""
    kept = new.landmarks.walls.rows["kept"]
    count = 0
    for before, after in zip(old.names, new.names, strict=True):
        spoken_for = np.where(before.walls >= 0, kept[before.walls], before.walls)
        count += int((spoken_for != after.walls).sum() + (before.corners != after.corners).sum())
    return count
