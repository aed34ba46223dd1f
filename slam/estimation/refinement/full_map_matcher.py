"""Every scan laid over the whole map: its walls, and the points of all passes through a place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ...geometry.segments import Floats
from ...localisation.tracker import CLEARLY_LIKER, MatchTarget
from ...mapping.landmarks import Landmarks
from ...mapping.local_map import LocalMap, landmarks_around
from ...mapping.mapper import REACH_MARGIN
from ...matching.likelihood_field import LikelihoodField, make_field
from ...matching.line_matcher import NEAR_STARTS, Registration
from .scan_history import ScanHistory

TILE = 4.0  # metres: scans taken within one square see one field of points
NEAR = 6.0  # metres from the middle of a tile, within which keyframes give it their points
MOST_KEYFRAMES = 40  # that do so, evenly taken
PRIOR_SIGMAS = np.array([0.2, 0.2, 0.1])  # metres, metres, radians: what walls and points leave open stays as it is
ASTRAY = 0.2  # metres from the even course between its neighbours, from which on a scan is laid there as well

NOTHING = np.zeros((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How a scan lies on the map. `astray` is whether odometry had put it clearly in the wrong place."""

    registration: Registration
    believable: bool
    odometry_wrong: bool


class PoseFix:
    """The map that scans are laid over: landmarks and keyframes at `poses` (k, 3), with all their points."""

    def __init__(self, history: ScanHistory, landmarks: Landmarks, poses: Floats, roughness: float) -> None:
        self._drive, self._landmarks, self._poses, self._flatness = history, landmarks, poses, roughness
        self._tile: tuple[int, int] | None = None
        self._fields: dict[int, LikelihoodField] = {}
        self._prior = np.diag(PRIOR_SIGMAS**-2)

    def local_map(self, row: int, pose: se2.Pose) -> LocalMap:
        """The landmarks that a sighting may show from `pose`: those that were there then."""
        reach = REACH_MARGIN + self._drive.scans[row].features.segments.reach()
        keyframe = int(np.searchsorted(self._drive.keyframes, row, side="right")) - 1
        return landmarks_around(self._landmarks, pose, reach, keyframe=keyframe)

    def match(self, row: int, poses: Floats, local_map: LocalMap) -> Alignment:
        """Lay a sighting over the map near where it is, and where the even course between its neighbours has it, if
        that is somewhere else; `poses` (n, 3) are those of all sightings."""
        scan = self._drive.scans[row].features
        around = MatchTarget(local_map, self._field(int(self._drive.anchors[row])), self._flatness)
        fit = around.match(scan, poses[row], self._prior, NEAR_STARTS[:1])
        course = self._even_course(row, poses)
        odometry_wrong = False
        if np.hypot(*(course - poses[row])[:2]) > ASTRAY:
            other = around.match(scan, course, self._prior, NEAR_STARTS[:1])
            odometry_wrong = other.both > fit.both + CLEARLY_LIKER
            fit = other if odometry_wrong else fit
        return Alignment(fit.registration, fit.believable, odometry_wrong)

    def covariance(self, registration: Registration) -> Floats:
        """(3, 3) of a pose found by laying a sighting over the map, in the base's frame."""
        information = registration.information + registration.point_information + self._prior
        return np.asarray(np.linalg.inv(information))

    def _even_course(self, row: int, poses: Floats) -> se2.Pose:
        """Where a sighting is if the base moved evenly from the one before to the one after it."""
        if not 0 < row < len(poses) - 1:
            return np.asarray(poses[row], dtype=np.float64)
        before, now, after = (self._drive.scans[r].stamp for r in (row - 1, row, row + 1))
        part = (now - before) / (after - before) if after > before else 0.5
        return se2.compose(poses[row - 1], part * se2.between(poses[row - 1], poses[row + 1]))

    def _field(self, keyframe: int) -> LikelihoodField:
        """The points around a keyframe, of every other one: a scan would not leave its place if its own were there."""
        tile = (int(self._poses[keyframe, 0] // TILE), int(self._poses[keyframe, 1] // TILE))
        if tile != self._tile:
            self._tile, self._fields = tile, {}
        half = 1 - keyframe % 2
        if half not in self._fields:
            self._fields[half] = self._make_field((np.array(tile) + 0.5) * TILE, half)
        return self._fields[half]

    def _make_field(self, centre: Floats, half: int) -> LikelihoodField:
        near = np.flatnonzero(np.hypot(*(self._poses[:, :2] - centre).T) < NEAR)
        near = near[near % 2 == half]
        near = near[:: max(1, -(-len(near) // MOST_KEYFRAMES))]
        scans = [self._drive.scans[self._drive.keyframes[k]].features.points for k in near]
        everything = _moved([scan.all for scan in scans], self._poses[near])
        return make_field(everything, _moved([scan.loose for scan in scans], self._poses[near]), centre)


def _moved(points: Sequence[Floats], poses: Floats) -> Floats:
    """Points of several scans, each in the frame of its pose, in the map (m, 2)."""
    return np.concatenate([se2.transform(pose, some) for pose, some in zip(poses, points, strict=True)] or [NOTHING])
