"""Keeping hold of the robot's pose from scan to scan, also where odometry fails.

Odometry may slip, stand still for a second and then catch up, or jump. A scan that neither falls on known walls nor on the
points of the last keyframes is not believed at once, and a pose that had to be searched for is held beside the one that
odometry tells until the next scan decides between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from drivers import se2

from .local_map import LocalMap
from .odometry import OdometryNoise
from .point_field import PointField, likeness, search
from .registration import NEAR_STARTS, Registration, ScanFeatures, register
from .segments import Floats

# Added to the odometry's own uncertainty when predicting a scan's pose: wheels slip, clocks differ. Metres and radians.
PREDICTION_SIGMAS = np.array([0.05, 0.05, np.radians(4.0)])
EXPLAINED_ENOUGH = 0.5  # share of a scan's wall length on known walls that alone makes a pose believable
LIKE_ENOUGH = 0.4  # likeness of a scan's points with those of the last keyframes that does
CLEARLY_LIKER = 0.1  # by which the points must lie better at a searched pose than at the predicted one
LEAST_EXPLAINED = 0.1  # share of wall length on known walls without which no searched pose is believed
PATIENCE = 4  # scans in a row that may be lost before odometry is believed again: the place is new, then


class Hold(Enum):
    """How a scan's pose was found."""

    FIRM = "firm"  # it fits the map where odometry led to, give or take
    SEARCHED = "searched"  # it fits the map elsewhere; the next scan must confirm that
    NONE = "none"  # it fits nowhere


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A pose of the base in the map and the odometry's pose at the same time."""

    pose: se2.Pose
    odometry: se2.Pose

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Where the base is in the map when odometry is at `odometry`."""
        return se2.compose(self.pose, se2.between(self.odometry, odometry))


class Tracker:
    """The last pose that is believed, and one that may replace it."""

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise = noise
        self._firm: Place | None = None
        self._searched: Place | None = None
        self._lost = 0

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """The pose at the last scan is `pose` in the map, as the map is now."""
        self._firm, self._searched, self._lost = Place(pose, odometry), None, 0

    def track(
        self, odometry: se2.Pose, scan: ScanFeatures, local_map: LocalMap, field: PointField, flatness: float
    ) -> tuple[Registration, Hold]:
        """The base's pose at a scan taken when odometry was at `odometry`, and how it was found."""
        if self._firm is None:
            self.move_to(np.zeros(3), odometry)
        assert self._firm is not None
        prior = self.prior(odometry)
        places = [self._firm] if self._searched is None else [self._firm, self._searched]
        found = [
            register(place.predict(odometry), prior, NEAR_STARTS, scan, local_map, field, flatness) for place in places
        ]
        best = max(found, key=lambda registration: registration.explained)
        like = likeness(field, scan.points.all, best.pose)
        if (
            best.explained >= EXPLAINED_ENOUGH
            or like >= LIKE_ENOUGH
            or self._lost >= PATIENCE
            or not len(local_map.walls)
        ):
            self.move_to(best.pose, odometry)
            return best, Hold.FIRM
        self._lost += 1
        searched, liker = search(field, scan.points.all, places[-1].predict(odometry))
        if liker >= max(LIKE_ENOUGH, like + CLEARLY_LIKER):
            far = register(searched, prior, NEAR_STARTS[:1], scan, local_map, field, flatness)
            if far.explained >= LEAST_EXPLAINED:
                self._searched = Place(far.pose, odometry)
                return far, Hold.SEARCHED
        return best, Hold.NONE

    def prior(self, odometry: se2.Pose) -> Floats:
        """(3, 3): information of the pose predicted with `odometry`, in the base's frame."""
        step = np.zeros(3) if self._firm is None else se2.between(self._firm.odometry, odometry)
        return np.asarray(np.linalg.inv(self._noise.covariance(step) + np.diag(PREDICTION_SIGMAS**2)))
