"""Data of keyframes: observations, landmark ids, and the motion that led to each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.segments import CornerPoints, Floats, Integers, Segments
from .data_association import LandmarkAssociation


@immutable
class KeyframeObservations:
    """Features of a keyframe and the landmarks they were associated with.

    segments, corners  n segments and m corners in the base's frame
    association        of these features with landmarks
    new_walls          ids of the walls that this keyframe added
    """

    segments: Segments
    corners: CornerPoints
    association: LandmarkAssociation
    new_walls: Integers


@immutable
class LandmarkIds:
    """Ids of the landmarks that a keyframe observed, for its segments (n,) and corners (m,); -1 for ambiguous ones."""

    walls: Integers
    corners: Integers

    def __deepcopy__(self, memo: dict[int, object]) -> LandmarkIds:
        """Return the object itself: landmark ids are never modified."""
        return self


@immutable
class KeyframeRecords:
    """Data of k keyframes besides the factor graph, as saved with a session; see the attributes of `MappedKeyframes`.

    keyframe_poses    (k, 3) in the map
    travelled         metres driven up to each keyframe
    landmark_ids      of each keyframe
    covariances       (k, 3, 3) `pose_covariances`, in the map's axes
    correlated_drift  (k, 2, 2) accumulated up to each keyframe, in the map's axes
    """

    keyframe_poses: Floats
    travelled: Sequence[float]
    landmark_ids: Sequence[LandmarkIds]
    covariances: Floats
    correlated_drift: Floats


@immutable
class KeyframeMotion:
    """Motion [x, y, heading] from an earlier keyframe, `start`, to a new one.

    covariance        (3, 3) in the new keyframe's frame, of the errors independent of other motions
    correlated_drift  (2, 2) of the position in the new keyframe's frame, of the errors shared with neighbouring motions
    """

    start: int
    motion: se2.Pose
    covariance: Floats
    correlated_drift: Floats = field(default_factory=lambda: np.zeros((2, 2)))


@immutable
class RelativeScanMatch:
    """Scan match: pose `relative` of a new keyframe in the frame of the points of an earlier one, `start`.

    covariance        (3, 3) in the new keyframe's frame, of the noise of its own scan
    start_covariance  (3, 3) in the earlier keyframe's frame, of the noise of that keyframe's scan; None if the graph
                      has it already
    """

    start: int
    relative: se2.Pose
    covariance: Floats
    start_covariance: Floats | None


@dataclass(frozen=True, slots=True)
class WallMerge:
    """The wall `absorbed` was merged into the wall `kept`, at a squared Mahalanobis `distance` from it."""

    kept: int
    absorbed: int
    distance: float
