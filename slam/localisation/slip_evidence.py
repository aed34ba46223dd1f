"""What the match of a scan says about odometry: that it holds, or that it has slipped."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..geometry.chi_square import chi_square_quantile
from ..geometry.significance import GATE
from ..matching.point_matcher import MIN_KNOWN_POINTS, PointMatch
from .match_target import ScanMatch
from .prediction_error import PREDICTION_SIGMAS
from .predictions import Alternative, Predictions

# Difference in cost up to which another place may be the right one. Origin: measured, where a lidar that sees 180
# degrees looks into a room for the first time, parallel walls fit together at wrong places, which cost up to 10.5 less
# with COARSE_SIGMA; with FINE_SIGMA, by which matches are compared, it was not measured again.
AMBIGUITY = 10.0
# Standard deviations of an even motion beyond which no robot moves, whatever odometry says.
# Origin: chi-square, 3 dof.
MAX_SLIP = math.sqrt(chi_square_quantile(GATE, 3))


@immutable
class SlipEvidence:
    """Evidence of a scan's match for and against the predictions by odometry."""

    match: ScanMatch
    predictions: Predictions

    @property
    def contradicts_odometry(self) -> bool:
        """True if the pose is beyond the errors of odometry since its reference."""
        return self.predictions.usual.excludes(self.match.points.pose)

    @property
    def odometry_holds(self) -> bool:
        """True if the pose is within the errors of odometry, and was not found from the prediction of a slip.

        After a tentative scan it may have been found from any prediction: poses around odometry were searched as well.
        """
        found_otherwise = bool(self.predictions.from_tentative) or not self.fits_slip
        return found_otherwise and not self.contradicts_odometry

    @property
    def confirms_slip(self) -> bool:
        """True if the pose confirms an earlier slip: it was found from a tentative one, or where odometry caught up."""
        fits_usual = self.match.points.prediction is self.predictions.usual
        return not (self.odometry_holds or fits_usual or self.fits_slip)

    @property
    def seems_slipped(self) -> bool:
        """True if only an even motion leads to the pose, and not odometry as well: the next scan has to confirm it."""
        if self.odometry_holds or not self.fits_slip:
            return False
        usual = self._match_near_usual
        return usual is None or not self._is_same_place(usual)

    @property
    def is_beyond_any_motion(self) -> bool:
        """True if the robot cannot have moved from the prediction of the match to its pose."""
        return self.match.points.prediction.squared_distance(self.match.points.pose) > MAX_SLIP**2

    @property
    def needs_impossible_motion(self) -> bool:
        """True if only an even motion leads to the pose, and not even that: no robot moves so far in this time."""
        return self.seems_slipped and self.is_beyond_any_motion

    @property
    def is_ambiguous(self) -> bool:
        """True if the scan fits about as well at another place."""
        most = self.match.points.cost + AMBIGUITY
        return any(other.cost < most and not self._is_same_place(other) for other in self.match.others)

    @property
    def alternative(self) -> Alternative | None:
        """Pose where the scan fits the usual prediction too, if it fits another one better; None if there is none."""
        other = self._match_near_usual
        if other is None or other.known < MIN_KNOWN_POINTS or other.poor:
            return None
        return Alternative(other.pose, other.cost - self.match.points.cost)

    @property
    def fits_slip(self) -> bool:
        """True if the best match is the one near the prediction of a slip."""
        return self.match.points.prediction is self.predictions.slip

    @property
    def _match_near_usual(self) -> PointMatch | None:
        """Match near the usual prediction, if another one is better."""
        near = (other for other in self.match.others if other.prediction is self.predictions.usual)
        return next(near, None)

    def _is_same_place(self, other: PointMatch) -> bool:
        """Return True if a match near another prediction has led to the same place: both predictions hold then."""
        return bool(np.all(np.abs(se2.between(other.pose, self.match.points.pose)) < PREDICTION_SIGMAS))
