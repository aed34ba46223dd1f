"""Match one scan to the map around the robot: all its points to the distance field, then its features to landmarks.

The points determine the scan's pose. The landmarks determine the pose at which its features are associated with them,
if the scan becomes a keyframe. Between keyframes, walls would not improve the pose: a line that is fitted to a rough or
curved surface is off by centimetres, in all scans from nearby in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..mapping.local_map import LocalMap
from ..matching.distance_field import DistanceField
from ..matching.line_matcher import Registration, ScanFeatures, register
from ..matching.point_matcher import (
    MIN_FIT,
    MIN_KNOWN_POINTS,
    POINT_SPACING,
    PointMatch,
    Prediction,
    match_points,
)
from ..matching.scan_points import surface_points


@dataclass(frozen=True, slots=True, eq=False)
class ScanMatch:
    """Match of a scan.

    points        best match of its points
    others        matches of its points near the other predictions, those with the lowest cost first
    registration  of its features with the landmarks, from the best match on
    """

    points: PointMatch
    others: Sequence[PointMatch]
    registration: Registration

    @property
    def score(self) -> float:
        """Overlap ratio plus fit, 0 to 2."""
        return self.registration.overlap_ratio + self.points.fit

    @property
    def plausible(self) -> bool:
        """True unless the scan shows space that was seen before, and does not fit it."""
        return self.points.known < MIN_KNOWN_POINTS or self.points.fit >= MIN_FIT


@dataclass(frozen=True, slots=True, eq=False)
class MatchTarget:
    """Map around the robot that a scan is matched to.

    landmarks  walls and corners, with covariances relative to the robot
    field      distance field of the keyframes around the robot
    roughness  variance of the wall roughness (metres squared)
    """

    landmarks: LocalMap
    field: DistanceField
    roughness: float

    def match(self, scan: ScanFeatures, predictions: Sequence[Prediction], *, exhaustive: bool = False) -> ScanMatch:
        """Match a scan near one of several predicted poses.

        For `exhaustive` see `match_points`.
        """
        points = surface_points(scan.points.all, scan.segments, POINT_SPACING)
        match, *others = match_points(self.field, points, predictions, exhaustive=exhaustive)
        prediction = match.prediction
        registration = register(
            match.pose, prediction.pose, prediction.information,
            scan, points, self.landmarks, self.field, self.roughness,
        )  # fmt: skip
        return ScanMatch(match, others, registration)
