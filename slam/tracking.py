"""Keeping hold of the robot's pose from scan to scan, also where odometry fails.

Odometry may slip, stand still for a second and then catch up, or jump. A scan that falls neither on known walls nor on
the points of the last keyframes is not believed where odometry puts it: its pose is searched for with the raw points,
and a few scans that fit nowhere are left out before the place is taken for new.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from drivers import se2

from .local_map import LocalMap
from .odometry import OdometryNoise, way_of
from .point_field import PointField, likeness, search
from .registration import NEAR_STARTS, Registration, ScanFeatures, register
from .segments import Floats

# Added to the odometry's own uncertainty when predicting a scan's pose: wheels slip, clocks differ. Metres and radians.
PREDICTION_SIGMAS = np.array([0.05, 0.05, np.radians(4.0)])
EXPLAINED_ENOUGH = 0.5  # share of a scan's wall length on known walls that alone makes a pose believable
FITS_ENOUGH = 0.6  # the same, and the likeness of its points with those of the last keyframes, that together do
CLEARLY_LIKER = 0.1  # by which the points must lie better at a searched pose than at the predicted one
SEARCHED_LIKE = 0.5  # likeness that a searched pose must reach
SEARCHED_POINTS = 30  # points that a scan must have for that: few of them lie well nearly everywhere
LARGE_STEP = 0.8  # metres of way between two scans, from which on odometry may be making up for what it missed
CLEARLY_BETTER = 0.3  # by which the scan must then fit better where the robot last was
PATIENCE = 4  # scans in a row that may be lost before odometry is believed again: the place is new, then


class Hold(Enum):
    """How a scan's pose was found."""

    FIRM = "firm"  # it fits the map where odometry led to, give or take
    SEARCHED = "searched"  # it fits the map elsewhere; nothing enters the path before the next scan bears it out
    NONE = "none"  # it fits nowhere near


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A pose of the base in the map and the odometry's pose at the same time."""

    pose: se2.Pose
    odometry: se2.Pose

    def predict(self, odometry: se2.Pose) -> se2.Pose:
        """Where the base is in the map when odometry is at `odometry`."""
        return se2.compose(self.pose, se2.between(self.odometry, odometry))


class Tracker:
    """The last pose that is believed, and the odometry's at that time."""

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise = noise
        self._firm: Place | None = None
        self._lost = 0
        # Where the robot was before its last pose was searched for: odometry may make up for what it missed in a step,
        # and the search may have been wrong.
        self._left: Place | None = None
        self.search_held = False  # whether the last scan bore out the pose that was searched for one scan earlier

    def move_to(self, pose: se2.Pose, odometry: se2.Pose) -> None:
        """The pose at the last scan is `pose` in the map, as the map is now."""
        self._firm, self._lost, self._left = Place(pose, odometry), 0, None

    def correct(self, pose: se2.Pose) -> None:
        """The map has changed, and the pose at the last scan with it."""
        assert self._firm is not None
        self._firm = Place(pose, self._firm.odometry)

    def track(
        self, odometry: se2.Pose, scan: ScanFeatures, local_map: LocalMap, field: PointField, flatness: float
    ) -> tuple[Registration, Hold]:
        """The base's pose at a scan taken when odometry was at `odometry`, and how it was found."""
        if self._firm is None:
            self.move_to(np.zeros(3), odometry)
        assert self._firm is not None
        prior = self.prior(odometry)
        predictions = [self._firm.predict(odometry)]
        if self._left is not None:
            predictions += [self._firm.pose, self._left.predict(odometry)]
        elif way_of(se2.between(self._firm.odometry, odometry)) > LARGE_STEP:
            predictions.append(self._firm.pose)
        found = [
            register(prediction, prior, NEAR_STARTS, scan, local_map, field, flatness) for prediction in predictions
        ]
        likes = [likeness(field, scan.points.all, registration.pose) for registration in found]
        fits = [registration.explained + like for registration, like in zip(found, likes, strict=True)]
        other = int(np.argmax(fits))
        choice = other if self._left is not None or fits[other] > fits[0] + CLEARLY_BETTER else 0
        best, like = found[choice], likes[choice]
        believable = best.explained >= EXPLAINED_ENOUGH or best.explained + like >= FITS_ENOUGH
        if believable or self._lost >= PATIENCE or not len(local_map.walls):
            self.search_held = self._left is not None and choice < len(predictions) - 1
            self.move_to(best.pose, odometry)
            return best, Hold.FIRM
        searched, liker = search(field, scan.points.all, predictions[-1])
        if len(scan.points.all) >= SEARCHED_POINTS and liker >= max(SEARCHED_LIKE, like + CLEARLY_LIKER):
            far = register(searched, prior, NEAR_STARTS[:1], scan, local_map, field, flatness)
            self.search_held = self._left is not None  # the second in a row
            left = self._firm
            self.move_to(far.pose, odometry)
            self._left = left
            return far, Hold.FIRM if self.search_held else Hold.SEARCHED
        self._lost += 1
        return best, Hold.NONE

    def prior(self, odometry: se2.Pose) -> Floats:
        """(3, 3): information of the pose predicted with `odometry`, in the base's frame."""
        step = np.zeros(3) if self._firm is None else se2.between(self._firm.odometry, odometry)
        return np.asarray(np.linalg.inv(self._noise.covariance(step) + np.diag(PREDICTION_SIGMAS**2)))
