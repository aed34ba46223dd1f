"""Results of tracking for tests of what follows from them."""

from __future__ import annotations

import numpy as np

from drivers import se2
from slam.geometry.segments import Floats
from slam.localisation.tracking import TrackingResult, TrackingStatus
from slam.matching.line_matcher import Registration
from slam.matching.point_matcher import MIN_KNOWN_POINTS, Prediction


def tracking_result(
    status: TrackingStatus = TrackingStatus.TRACKED,
    *,
    pose: se2.Pose | None = None,
    information: Floats | None = None,
    registration: Registration | None = None,
    predicted: Prediction | None = None,
    known: int = MIN_KNOWN_POINTS,
    poor: bool = False,
    slipped: bool = False,
    explained: float = 1.0,
) -> TrackingResult:
    """Return the result of a scan at `pose`, the origin by default, with the information (3, 3) from walls alone."""
    pose = np.zeros(3) if pose is None else pose
    information = np.eye(3) if information is None else information
    covariance = np.linalg.inv(information)
    return TrackingResult(
        pose,
        covariance,
        registration or Registration(pose, information, pose, np.zeros((3, 3)), 1.0, 1.0, 0),
        covariance,
        predicted or Prediction(pose, np.eye(3)),
        status,
        explained,
        known,
        poor=poor,
        slipped=slipped,
        fits_by_chance=False,
    )
