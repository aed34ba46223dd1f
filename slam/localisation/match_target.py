"""Match one scan to the map around the robot: all its points to the distance field, then its features to landmarks.

The points determine the scan's pose. If the scan becomes a keyframe, its features are associated with landmarks at the
pose that these determine. Between keyframes landmarks do not count: a line that is fitted to a rough or curved surface
is off by centimetres, and scans from nearby repeat this error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from features.normal_limits import NORMAL_LIMIT

from ..geometry.roughness import Roughness
from ..geometry.segments import Floats
from ..mapping.local_map import LocalMap
from ..matching.distance_field import DistanceField
from ..matching.line_matcher import Registration, register
from ..matching.point_costs import excess_cost
from ..matching.point_matcher import (
    MIN_FIT,
    MIN_KNOWN_POINTS,
    POINTS_PER_OBJECT,
    SEARCH_FIT,
    PointMatch,
    Prediction,
    match_from,
    match_points,
    point_cost,
)
from ..matching.scan_features import ScanFeatures
from .prediction_error import PREDICTION_SIGMAS

# Evidence (nats) from which on points contradict a prediction. Origin: definition, that of a difference of NORMAL_LIMIT
# standard deviations.
MIN_EVIDENCE = 0.5 * NORMAL_LIMIT**2


@immutable
class ScanMatch:
    """Match of a scan.

    points        best match of its points
    others        matches of its points near the other predictions, those with the lowest cost first
    registration  of its features with the landmarks, from the best match on
    explained     0 to 1, share of all points that lie on known surfaces, or on objects that may have moved
    evidence      (nats) of this scan and of earlier ones against the first prediction; zero if that holds
    """

    points: PointMatch
    others: Sequence[PointMatch]
    registration: Registration
    explained: float
    evidence: float

    @property
    def fit(self) -> float:
        """Fit of all points at the registered pose, 0 to 1."""
        return self.registration.fit

    @property
    def known(self) -> int:
        """Number of points in space that was seen before."""
        return self.registration.known

    @property
    def score(self) -> float:
        """Overlap ratio plus fit, 0 to 2."""
        return self.registration.overlap_ratio + self.fit

    @property
    def poor(self) -> bool:
        """True if a considerable part of what the scan shows of known space does not fit."""
        return self.known >= MIN_KNOWN_POINTS and self.fit < SEARCH_FIT

    @property
    def plausible(self) -> bool:
        """True unless the scan shows space that was seen before, and does not fit it."""
        return self.known < MIN_KNOWN_POINTS or self.fit >= MIN_FIT

    def contradicts(self, usual: Prediction) -> bool:
        """Return True if the scan fits better near another prediction, or far from the usual one."""
        return self.points.prediction is not usual or usual.excludes(self.points.pose)


@immutable
class MatchTarget:
    """Map around the robot that a scan is matched to.

    landmarks  walls and corners, with covariances relative to the robot
    field      distance field of the keyframes around the robot
    roughness  of the walls
    recent     returns the distance field of the last metres alone; None if nothing was mapped there
    """

    landmarks: LocalMap
    field: DistanceField
    roughness: Roughness
    recent: Callable[[], DistanceField] | None = None

    def match(
        self,
        scan: ScanFeatures,
        predictions: Sequence[Prediction],
        points: Floats | None = None,
        *,
        exhaustive: bool = False,
        earlier_evidence: float | None = None,
        after_gap: bool = False,
    ) -> ScanMatch:
        """Match a scan near one of several predicted poses.

        points            (p, 6) of the scan with their weights; None if all weights are 1
        exhaustive        see `match_points`
        earlier_evidence  (nats) of earlier scans against the first prediction. That prediction holds, and its match is
                          returned although another one costs less, unless this evidence and that of the scan add up
                          to MIN_EVIDENCE. None if the match that costs least is always returned
        after_gap         True if the robot may have moved beyond the searched poses since the last fix, so that a place
                          far away is one of many that may look alike: the first prediction holds then unless the
                          points contradict its match, also if it is out of the prediction's reach
        """
        points = points_of(scan) if points is None else points
        match, *others = match_points(self.field, points, predictions, exhaustive=exhaustive)
        evidence = 0.0
        if earlier_evidence is not None:
            near = next(some for some in (match, *others) if some.prediction is predictions[0])
            near = near if after_gap else _in_reach(near)
            if near is not match:
                evidence = earlier_evidence + self._evidence(points, near.pose, match.pose)
                if evidence < MIN_EVIDENCE:
                    match, others, evidence = near, [], 0.0
        prediction = match.prediction
        registration = register(
            match.pose, prediction.pose, prediction.information,
            scan, points, self.landmarks, self.field, self.roughness,
        )  # fmt: skip
        explained = registration.fit * registration.known / max(1, len(points))
        return ScanMatch(match, others, registration, explained, evidence)

    def excludes(self, prediction: Prediction, points: Floats, pose: se2.Pose) -> bool:
        """Return True if points (p, 6) that fit at a pose contradict a prediction, which may lead to another one."""
        near = _in_reach(match_points(self.field, points, [prediction])[0])
        return self._evidence(points, near.pose, pose) >= MIN_EVIDENCE

    def compare(self, points: Floats, prediction: Prediction, pose: se2.Pose) -> tuple[PointMatch | None, float]:
        """Return the match of points (p, 6) near a prediction, and the evidence (nats) for it against a pose.

        Returns no match, and the evidence for the predicted pose itself, if the match leads to the pose that it is
        compared with, or if all points of the map contradict the prediction. Otherwise only what was mapped in the last
        metres counts: what an earlier pass mapped at a displaced pose would look like a slip.
        """
        if (evidence := self._evidence(points, pose, prediction.pose)) <= -MIN_EVIDENCE:
            return None, evidence  # true of most scans: the field of the last metres takes long to build
        target = self if self.recent is None else replace(self, field=self.recent())
        match = match_from(target.field, points, prediction.pose, prediction)
        if np.all(np.abs(se2.between(match.pose, pose)) < PREDICTION_SIGMAS):
            return None, target._evidence(points, pose, prediction.pose)
        return match, target._evidence(points, pose, match.pose)

    def _evidence(self, points: Floats, pose: se2.Pose, other: se2.Pose) -> float:
        """Return the evidence (nats) of points (p, 6) against a pose and for another one.

        A scan that fits at both, as in a bare corridor, is no evidence.
        """
        return float(excess_cost(self.field.arrays, points, pose, other)) / POINTS_PER_OBJECT

    def contradicts(self, points: Floats, pose: se2.Pose) -> bool:
        """Return True if points (p, 6) at a pose contradict the map: many of those in known space do not fit."""
        _, fit, known = point_cost(self.field, points, pose)
        return known >= MIN_KNOWN_POINTS and fit < SEARCH_FIT


def _in_reach(match: PointMatch) -> PointMatch:
    """Return a match at its prediction instead if that excludes its pose."""
    prediction = match.prediction
    return replace(match, pose=prediction.pose) if prediction.excludes(match.pose) else match


@lru_cache(maxsize=1)  # a scan is matched with several fields in a row
def points_of(scan: ScanFeatures) -> Floats:
    """Return the points (p, 6) of a scan that are matched, with their normals; not to be changed."""
    return scan.surface_points()
