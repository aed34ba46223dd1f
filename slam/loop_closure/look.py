"""A look at old places: the points of the last keyframes, matched with those of earlier passes.

The old places are those where the robot may be by the uncertainty of the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..geometry.pose_covariance import covariance_after, position_sigma, squared_distance
from ..geometry.segments import Floats, Integers
from ..localisation.local_field import REFERENCE_DISTANCE, LocalField
from ..mapping.mapper import Mapper
from ..matching.distance_field import FIELD_HALF_WIDTH
from .decision import LoopMatch
from .loop_hypothesis import OldPlace
from .relative_uncertainty import MAX_SQUARED_DISTANCE, SEARCH_DEVIATIONS, UNMODELLED_SIGMAS, RelativeUncertainty
from .submap_search import REVISIT_GAP, SUBMAP_LENGTH, Submap, SubmapMatch, improve, search_submap
from .submaps import Submaps, submap_of

# Metres of driving between two looks. Origin: chosen, a third of a submap; not measured.
SEARCH_INTERVAL = SUBMAP_LENGTH / 3.0
# Metres of driving between the middles of the submaps of old places. Origin: definition, half a submap.
SUBMAP_INTERVAL = SUBMAP_LENGTH / 2.0
# Metres around an old place within which the robot is searched if the estimate is in doubt: it may be beside the
# path of earlier passes. Origin: chosen, for time, as the width of a road; not measured.
DOUBTED_REACH = 2.0 * REFERENCE_DISTANCE


class Look:
    """The submap that ends at a keyframe, to be matched with the submaps of old places.

    An old place is named by the keyframe in the middle of its submap. By default old places are those of earlier
    passes: the robot has driven more than two submaps since.

    among     (k,) true for keyframes that may belong to old places; None for all
    apart     true if old places are in a part of the map that is not connected with the keyframe's: then they may be
              at any distance driven
    keyframe  index of the keyframe; None for the last one
    doubted   true if the errors of the estimate may be correlated along the drive, see `RelativeUncertainty`
    """

    def __init__(
        self,
        mapper: Mapper,
        local_field: LocalField,
        submaps: Submaps,
        among: NDArray[np.bool_] | None = None,
        *,
        apart: bool = False,
        keyframe: int | None = None,
        doubted: bool = False,
    ) -> None:
        self._mapper, self._field, self._submaps, self._among = mapper, local_field, submaps, among
        self._travelled = np.asarray(mapper.travelled)
        self._driven = local_field.path_distances(mapper.travelled).driven
        self.last = mapper.keyframe_count - 1 if keyframe is None else keyframe
        self.travelled = float(self._travelled[self.last])
        self.uncertainty = RelativeUncertainty(mapper, self.last, doubted=doubted)
        poses = mapper.keyframe_poses
        self.pose = poses[self.last]
        self._apart, eligible = apart, np.ones(len(poses), dtype=bool) if among is None else among
        self._seen_before = eligible & (apart | (self._travelled < self.travelled - SUBMAP_LENGTH))
        old = np.flatnonzero(eligible & (apart | (self._travelled < self.travelled - REVISIT_GAP)))
        number = np.floor(self._travelled[old] / SUBMAP_INTERVAL)
        self._old = old[np.flatnonzero(np.diff(number, prepend=-1.0))]  # keyframes in the middle of old submaps
        self._submap: Submap | None = None
        self._deviations: dict[tuple[int, int], float] = {}  # metres, by the keyframes of earlier matches

    def doubting_estimate(self) -> Look:
        """Return the same look, for which the errors of the estimate may be correlated along the drive."""
        other = copy(self)
        other.uncertainty, other._deviations = RelativeUncertainty(self._mapper, self.last, doubted=True), {}
        return other

    def at_distance(self, travelled: float) -> Look | None:
        """Return the look from the last keyframe up to a distance driven (metres); None if that is in another part."""
        keyframe = int(np.searchsorted(self._travelled, travelled, side="right")) - 1
        if keyframe < self.first_of_part:
            return None
        return Look(
            self._mapper, self._field, self._submaps, self._among,
            apart=self._apart, keyframe=keyframe, doubted=self.uncertainty.doubted,
        )  # fmt: skip

    def determines_motion_to(self, later: int) -> bool:
        """Return True if scans determine the whole motion from this look's keyframe to a later one."""
        return not self._field.is_undetermined(self.last, later)

    @property
    def submap(self) -> Submap:
        """Submap that ends at the keyframe of the look, in its frame."""
        if self._submap is None:
            recent = self._driven > self._driven[self.last] - SUBMAP_LENGTH
            recent[self.last + 1 :] = False
            self._submap = submap_of(self._place(np.flatnonzero(recent), self.last), self._field)
        return self._submap

    def old_submap(self, old: int) -> Submap:
        """Return the submap of an old place, in the frame of the keyframe in its middle."""
        return self._submaps.get(old, self._place_around, self._field)

    def _place_around(self, old: int) -> OldPlace:
        around = np.abs(self._driven - self._driven[old]) < SUBMAP_LENGTH
        around &= self._seen_before
        return self._place(np.flatnonzero(around), old)

    def _place(self, keyframes: Integers, centre: int) -> OldPlace:
        """Return keyframes (n,) with their present poses in the frame of one of them."""
        poses = self._mapper.keyframe_poses
        return OldPlace(keyframes, se2.between(poses[centre], poses[keyframes]).reshape(-1, 3))

    def place_at(self, pose: se2.Pose) -> int | None:
        """Return the keyframe in the middle of the oldest submap near a pose in the map; None if there is none."""
        near = self._distances_to(pose) < REFERENCE_DISTANCE
        return int(self._old[near.argmax()]) if near.any() else None

    def place_in_view(self, pose: se2.Pose) -> int | None:
        """Return the place at a pose in the map, or else the nearest one whose points may be seen from there."""
        if (place := self.place_at(pose)) is not None:
            return place
        distances = self._distances_to(pose)
        return int(self._old[distances.argmin()]) if distances.min(initial=np.inf) < FIELD_HALF_WIDTH else None

    def _distances_to(self, pose: se2.Pose) -> Floats:
        """Return the distances (m,) of the middles of all old submaps from a pose in the map, metres."""
        return np.asarray(np.hypot(*(self._mapper.keyframe_poses[self._old, :2] - pose[:2]).T))

    def possible_places(self) -> list[int]:
        """Return the old places where the robot may be by the uncertainty of the estimate.

        Of places closer together than REFERENCE_DISTANCE the oldest one stands for all. Covariances relative to a place
        take long to compute. So places are first left out by an upper bound of the standard deviation: the sum of those
        of both positions.
        """
        poses, sigmas = self._mapper.keyframe_poses, _position_sigmas(self._mapper.pose_covariances)
        deviations = self.uncertainty.error_scale(self._old, self.last) * (sigmas[self._old] + self._last_sigma(sigmas))
        bound = SEARCH_DEVIATIONS * (deviations + UNMODELLED_SIGMAS[0])
        chosen = list[int]()
        for keyframe in self._old[self._distances_to(self.pose) < bound + REFERENCE_DISTANCE].tolist():
            if np.hypot(*(poses[chosen, :2] - poses[keyframe, :2]).T).min(initial=np.inf) > REFERENCE_DISTANCE:
                chosen.append(keyframe)
        self.uncertainty.find_covariances(chosen)
        reach = {old: self.uncertainty.search_radius(old) + REFERENCE_DISTANCE for old in chosen}
        return [old for old in chosen if np.hypot(*(poses[old, :2] - self.pose[:2])) < reach[old]]

    def _last_sigma(self, sigmas: Floats) -> float:
        """Return the standard deviation of the last position in the part of the map with the old places, metres.

        sigmas  (k,) of the positions of all keyframes, each in its own part
        """
        if not self._apart or not len(self._old):
            return float(sigmas[self.last])
        newest = int(self._old[-1])
        return float(sigmas[newest] + self.uncertainty.deviation(newest))

    def relative(self, old: int, motion: se2.Pose) -> se2.Pose:
        """Return the pose of the submap in that of an old place, if the robot is moved in the map by `motion`."""
        return se2.between(self._mapper.keyframe_poses[old], se2.compose(motion, self.pose))

    def motion(self, old: int, relative: se2.Pose) -> se2.Pose:
        """Return the motion in the map that a pose of the submap in that of an old place implies."""
        return self._motion(old, relative, self.last)

    def motion_of(self, match: LoopMatch) -> se2.Pose:
        """Return the motion in the map that the match of this look, or of another one, implies."""
        return self._motion(match.old, match.relative, match.keyframe)

    def _motion(self, old: int, relative: se2.Pose, keyframe: int) -> se2.Pose:
        """Return the motion in the map that moves a keyframe to a pose relative to an old one."""
        poses = self._mapper.keyframe_poses
        return se2.compose(se2.compose(poses[old], relative), se2.inverse(poses[keyframe]))

    def admits(self, old: int, relative: se2.Pose) -> bool:
        """Return True if the estimate's uncertainty admits a pose of the submap in that of an old place."""
        return self.squared_distance(old, relative) < MAX_SQUARED_DISTANCE

    def squared_distance(self, old: int, relative: se2.Pose) -> float:
        """Return the squared Mahalanobis distance of a pose of the submap in that of an old place from the estimate."""
        return squared_distance(self.relative(old, np.zeros(3)), relative, self.uncertainty.covariance(old))

    def compared_points(self, old: int) -> tuple[Floats, Floats]:
        """Return the points (n, 2) of the submap and those (m, 2) of an old place's, both in the map, metres."""
        recent = se2.transform(self.pose, self.submap.points[:, :2])
        return recent, se2.transform(self._mapper.keyframe_poses[old], self.old_submap(old).points[:, :2])

    def deviation_at(self, match: LoopMatch) -> float:
        """Return the standard deviation (metres) of the estimated position at a match, in the worst direction.

        match  of this look, or of an earlier one; the position is relative to the match's old place
        """
        if match.keyframe == self.last:
            return self.uncertainty.deviation(match.old)
        place = match.keyframe, match.old
        if place not in self._deviations:
            uncertainty = RelativeUncertainty(self._mapper, match.keyframe, doubted=self.uncertainty.doubted)
            self._deviations[place] = uncertainty.deviation(match.old)
        return self._deviations[place]

    def distance_shown_before(self, match: LoopMatch) -> float:
        """Return the metres of driving before a match that its submap shows; it does not reach into another part."""
        return min(SUBMAP_LENGTH, match.travelled - float(self._travelled[self.first_of_part]))

    def extent_since(self, travelled: float) -> float:
        """Return the largest distance between positions of the robot, metres, from a distance driven on."""
        x, y = self._mapper.keyframe_poses[self.keyframe_at(travelled) : self.last + 1, :2].T
        return float(np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y)).max())

    def keyframe_at(self, travelled: float) -> int:
        """Return the first keyframe from a distance driven (metres) on."""
        return int(np.searchsorted(self._travelled, travelled))

    @property
    def first_of_part(self) -> int:
        """First keyframe of the connected part of the map of the last one."""
        return self._mapper.landmarks.parts.current_first

    def agrees(self, old: int, match: SubmapMatch) -> bool:
        """Return True if the estimate agrees with a match: the robot is back, and nothing has to be corrected."""
        return squared_distance(self.relative(old, np.zeros(3)), match.pose, match.covariance) < MAX_SQUARED_DISTANCE

    def consistent(self, matches: Sequence[LoopMatch]) -> list[LoopMatch]:
        """Return the last of some matches, and the earlier ones that are consistent with all later ones."""
        kept: list[LoopMatch] = []
        for match in reversed(matches):
            if all(self._are_consistent(match, later) for later in kept):
                kept.insert(0, match)
        return kept

    def _are_consistent(self, match: LoopMatch, other: LoopMatch) -> bool:
        """Return True if the motion from one match to another over the old map agrees with the estimate.

        Adding the covariance of the estimate can only make the distance smaller, and takes long to compute. So it is
        added only if the distance by the covariances of the matches alone is too large.
        """
        poses = self._mapper.keyframe_poses
        over_old = se2.between(*(se2.compose(poses[m.old], m.relative) for m in (match, other)))
        estimated = se2.between(poses[match.keyframe], poses[other.keyframe])
        covariance = np.diag(UNMODELLED_SIGMAS**2) + covariance_after(match.covariance, over_old) + other.covariance
        if squared_distance(estimated, over_old, covariance) < MAX_SQUARED_DISTANCE:
            return True
        scale = float(self.uncertainty.error_scale(match.keyframe, other.keyframe))
        covariance += scale**2 * self._mapper.covariances.relative(match.keyframe, other.keyframe)
        return squared_distance(estimated, over_old, covariance) < MAX_SQUARED_DISTANCE

    @property
    def _widest_reach(self) -> float:
        """Metres to each side within which a pose is searched at an old place."""
        return DOUBTED_REACH if self.uncertainty.doubted else REFERENCE_DISTANCE

    def search(self, old: int) -> Sequence[SubmapMatch]:
        """Return the poses of the submap in that of an old place that the estimate's uncertainty admits."""
        prediction, reach = self.relative(old, np.zeros(3)), self.uncertainty.search_radius(old)
        if reach > self._widest_reach:  # the robot is near this place, or else near another one
            prediction = np.array([0.0, 0.0, prediction[2]])
        reach = min(self._widest_reach, reach)
        turn = SEARCH_DEVIATIONS * float(np.sqrt(self.uncertainty.covariance(old)[2, 2]))
        found = search_submap(self.submap, self.old_submap(old), prediction, reach, turn)
        return [match for match in found if self.admits(old, match.pose)]

    def test(self, old: int, motion: se2.Pose, since: int) -> SubmapMatch:
        """Return the match of the submap with an old place near the pose that a hypothesis implies.

        motion  of the hypothesis, in the map
        since   keyframe of the last look that supports the hypothesis. If scans do not determine the motion from there
                on, all poses near it within the uncertainty of this motion are searched
        """
        start = self.relative(old, motion)
        match = improve(self.submap, self.old_submap(old), start)
        if self._field.is_undetermined(since, self.last):
            covariance = self._mapper.covariances.relative(since, self.last)
            reach = min(self._widest_reach, SEARCH_DEVIATIONS * position_sigma(covariance))
            turn = SEARCH_DEVIATIONS * float(np.sqrt(covariance[2, 2]))
            found = search_submap(self.submap, self.old_submap(old), start, reach, turn)
            distances = [squared_distance(start, m.pose, covariance + m.covariance) for m in found]
            within = [m for m, squared in zip(found, distances, strict=True) if squared < MAX_SQUARED_DISTANCE]
            match = max([match, *within], key=lambda m: m.score)
        return match

    def loop_match(self, old: int, match: SubmapMatch) -> LoopMatch:
        """Return a match as one that a loop can be closed with."""
        return LoopMatch(self.last, old, match.pose, match.covariance, self.travelled, match.fit, match.known)


def _position_sigmas(covariances: Floats) -> Floats:
    """Return the standard deviation (n,) in the worst direction of positions with covariances (n, 3, 3)."""
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    return np.asarray(np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)))
