"""What is known of keyframes beside the graph: what each saw, which landmarks that is, how it was reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers import se2

from ..geometry.segments import CornerPoints, Floats, Integers, Segments


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeObservations:
    """What a keyframe saw, and which landmarks that is.

    walls (n,) and corner_landmarks (m,) are identities, -1 for what is too ambiguous to be assigned; the distances are
    squared Mahalanobis distances to the nearest candidate, NaN without one; that is nearest_wall and nearest_corner,
    identities, -1 without one, whether it was taken or not. new_walls are identities.
    """

    segments: Segments
    corners: CornerPoints
    walls: Integers
    wall_distance: Floats
    nearest_wall: Integers
    corner_landmarks: Integers
    corner_distance: Floats
    nearest_corner: Integers
    new_walls: Integers


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkIds:
    """Which landmarks a keyframe saw: identities for its segments (n,) and corners (m,), -1 for what is ambiguous."""

    walls: Integers
    corners: Integers

    def __deepcopy__(self, memo: dict[int, object]) -> LandmarkIds:
        """Itself: names are never changed."""
        return self


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeRecords:
    """What a mapper remembers of its k keyframes, beside the graph; see there."""

    keyframe_poses: Floats
    travelled: Sequence[float]
    landmark_ids: Sequence[LandmarkIds]
    covariances: Sequence[Floats]
    correlated_drift: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion [x, y, heading] from an earlier keyframe to a new one.

    covariance  (3, 3) in the new one's frame, of errors that no other motion shares
    adrift      (2, 2) of the position, likewise, of errors that its neighbours share where nothing held the robot
    """

    start: int
    motion: se2.Pose
    covariance: Floats
    correlated_drift: Floats = field(default_factory=lambda: np.zeros((2, 2)))


@dataclass(frozen=True, slots=True)
class Merge:
    """The wall `absorbed` is the wall `kept`, found at a squared Mahalanobis distance."""

    kept: int
    absorbed: int
    distance: float
