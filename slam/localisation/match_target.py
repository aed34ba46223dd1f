"""Match one scan to the local map and score the result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..mapping.local_map import LocalMap
from ..matching.likelihood_field import LikelihoodField, likelihood_score
from ..matching.line_matcher import NEAR_STARTS, Registration, ScanFeatures, register

# Overlap ratio that alone makes a pose plausible. Origin: chosen; no measurement recorded.
MIN_OVERLAP_RATIO = 0.5
# Sum of overlap ratio and likelihood score that makes a pose plausible.
# Origin: chosen; no measurement recorded.
MIN_TOTAL_SCORE = 0.6
# Metres around a known wall that count as mapped area. Origin: chosen, about the width of a door; not measured.
MAPPED_DISTANCE = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ScanMatch:
    """Registration of a scan, and the likelihood score (0 to 1) of its points at the registered pose."""

    registration: Registration
    likelihood: float

    @property
    def score(self) -> float:
        """Overlap ratio plus likelihood score, 0 to 2."""
        return self.registration.overlap_ratio + self.likelihood

    @property
    def plausible(self) -> bool:
        """True if the scan fits the map well enough for its pose to be accepted."""
        return self.registration.overlap_ratio >= MIN_OVERLAP_RATIO or self.score >= MIN_TOTAL_SCORE


@dataclass(frozen=True, slots=True, eq=False)
class MatchTarget:
    """Map around the robot that a scan is matched to.

    landmarks  walls and corners, with covariances relative to the robot
    field      likelihood field of the last keyframes' points
    roughness  variance of the wall roughness (metres squared)
    """

    landmarks: LocalMap
    field: LikelihoodField
    roughness: float

    def match(self, scan: ScanFeatures, prediction: se2.Pose, prior: Floats, starts: Floats = NEAR_STARTS) -> ScanMatch:
        """Register a scan near a predicted pose; see `register` for the arguments."""
        registration = register(prediction, prior, starts, scan, self.landmarks, self.field, self.roughness)
        return ScanMatch(registration, likelihood_score(self.field, scan.points.all, registration.pose))

    def mapped_ratio(self, scan: ScanFeatures, pose: se2.Pose) -> float:
        """Return the share of a scan's wall length, seen from `pose`, that lies in the mapped area (0 to 1)."""
        walls, segments = self.landmarks, scan.segments
        centres = se2.transform(pose, segments.frame[:, :2])
        local = se2.transform(se2.inverse(walls.frame)[:, None], centres[None])  # (walls, segments, 2)
        beyond = np.maximum(0.0, np.maximum(walls.low[:, None] - local[..., 0], local[..., 0] - walls.high[:, None]))
        mapped = np.hypot(beyond, local[..., 1]).min(axis=0, initial=np.inf) < MAPPED_DISTANCE
        total = float(segments.half_length.sum())
        return float(segments.half_length[mapped].sum()) / total if total else 0.0
