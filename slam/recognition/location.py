"""Locate a drive in a map: decide on one placement of all its submaps.

A single submap may be mistaken for a similar place, and in a corridor of equal doors each of them is. All submaps
together are in one place only, which is decided on by the evidence of all cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ..formatting import percent, percent_apart
from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats, Integers
from ..loop_closure.criteria import MIN_KNOWN, MIN_LOOP_FIT
from ..loop_closure.submap_search import DISTINCT_SHIFT, DISTINCT_TURN, DISTORTION_SIGMAS, NO_PRIOR, are_distinct
from ..matching.offset_tiles import MAX_CORRECTED_SIGMA
from ..matching.point_matcher import point_cost
from .evidence import chances_of_fit, compare_cells, evidence_of
from .placements import Placement, Uncertainty, find_placements, matched_walls
from .scanned_map import ScannedDrive, ScannedMap

# Rival placements that a refusal names. Origin: chosen, for a message of some lines.
MAX_NAMED_RIVALS = 3
# Mean share, 0 to 1, of the surfaces in a drive's scans that are in space the map has not seen, if the drive is where
# it was placed. Origin: measured, in the middle of 0 to 0.18 in recordings of six buildings.
MEAN_UNMAPPED = 0.09


@dataclass(frozen=True, slots=True)
class Expectation:
    """Knowledge about the place of a drive before it is searched for, and what a decision requires.

    prior         probability that the drive is in the map
    error         largest probability of a wrong decision, if cells are independent; neighbouring ones are not quite
    fully_mapped  true if the map is expected to contain all that the drive shows. If less is mapped, much of the
                  building is not mapped either, and a place there may look like one in the map.
    stated        true if a person has said that the drive is in the map, and so at no place that only looks alike
    """

    prior: float
    error: float
    fully_mapped: bool = True
    stated: bool = False

    @property
    def required(self) -> float:
        """Evidence that is required, nats: the logarithm of the odds of a right decision."""
        return math.log((1.0 - self.error) / self.error)


# Of a robot that is said to be in a map. Origin: prior chosen, statements are right 19 times of 20; else as LOST.
STATED = Expectation(prior=0.95, error=0.001, stated=True)
# Of a robot that has lost its pose, and may have been carried out of the map. Origin: prior by definition, nothing is
# known; error chosen, with 0.01 drives were put at the wrong one of two equal places.
LOST = Expectation(prior=0.5, error=0.001)
# Of a drive that looks at old places have recognised about where the estimate has it. Origin: as LOST.
RETURNED = LOST
# Likewise, at another place. Origin: error by definition, the square: a surface that both maps show is a cell of each.
# So furniture that was moved together counts twice, and to follow it would bend the map.
RECOGNISED = Expectation(prior=0.5, error=RETURNED.error**2)
# Likewise, where the robot can only be if the estimate's covariance is wrong. Origin: definition, the share of right
# covariances that a test at the usual level of significance takes for wrong ones.
DOUBTED = Expectation(prior=0.05, error=RECOGNISED.error)
# Of a session that may overlap with another one in a part, or not. Origin: chosen, a smaller error than that of a
# robot, whose further scans can contradict the decision.
OVERLAP = Expectation(prior=0.5, error=0.0001, fully_mapped=False)


@immutable
class PlacedSubmap:
    """Submap that was placed in another map.

    keyframes   of the submap
    pose        (3,) of its last keyframe in the other map
    covariance  (3, 3) of the pose from the points of the submap alone, in the pose's frame
    motion      [x, y, heading] of its own session's map in the other map, according to this submap
    walls       landmark ids (n, 2) of coinciding walls: in the other map, in its own
    fit         share of its points in space that was seen that fit
    known       share of its points in space that was seen
    """

    keyframes: range
    pose: se2.Pose
    covariance: Floats
    motion: se2.Pose
    walls: Integers
    fit: float
    known: float


@immutable
class Location:
    """Decision on the placement of a drive in a map.

    submaps   number of submaps
    members   submaps that are certain to be where the best placement has them, which the maps are joined by
    evidence  logarithm of the odds for the place of the most certain submap against all others and an unknown place
    required  evidence that is required, nats
    support   logarithm of the likelihood ratio of any place in the map to an unknown place, nats
    reason    text of the numbers that the placement is accepted or rejected by
    """

    submaps: int
    members: Sequence[PlacedSubmap]
    evidence: float
    required: float
    support: float
    reason: str

    @property
    def accepted(self) -> bool:
        """True if the evidence suffices."""
        return bool(self.members)


def locate(
    new: ScannedDrive,
    old: ScannedMap,
    expected: Expectation,
    near: Uncertainty | None = None,
    similarity: Callable[[ScannedDrive], float] | None = None,
) -> Location:
    """Search for a drive in a map, or `near` the place that it has there already, and decide on its placement.

    Before, the drive is in the map with the `expected` probability: at each of its places with the same one, or with
    that of the uncertainty `near` its own place. Else it is at an unknown place. By Bayes' theorem, the evidence of
    each placement gives its probability, and the sum over those that have a submap at the same place gives the
    probability of that place. Submaps are accepted at the best placement if it is wrong with a probability of at most
    `expected.error`. So a drive that fits in several places is refused, however well it fits in each.

    similarity  returns how much a drive at an unknown place resembles places of the map, see `SelfSimilarity.of`; asked
                if the evidence suffices otherwise, unless it is stated that the drive is in the map. None if places
                look alike by chance only
    """
    placements, count = find_placements(new, old, near), len(new.submaps)
    if not placements:
        reason = f"none of its {count} submaps lies on walls of it"
        return Location(count, (), -math.inf, expected.required, -math.inf, reason)
    comparison = _Comparison(new, old, placements, expected, near)
    location = comparison.decide()
    if location.accepted and similarity is not None and not expected.stated:
        comparison.expect_similar_places(similarity(new))
        location = comparison.decide()
    return location


def number_of_places(area: float, near: Uncertainty | None) -> float:
    """Return how many places the search distinguishes in a map that has seen `area` square metres.

    near  admits only some of them
    """
    volume = 2.0 * math.pi * area if near is None else min(near.volume, 2.0 * math.pi * area)
    return volume / (2.0 * DISTINCT_SHIFT) ** 2 / (2.0 * DISTINCT_TURN)


def least_mapped(log_density: float) -> float:
    """Return the least share of what a drive shows that must be mapped, above 1 if no share suffices.

    A place that is not mapped may look exactly like the place of the placement. If the drive is there, all shares are
    equally likely, and so are all poses within the uncertainty of the drive. If the placement is right, the share that
    is not mapped is distributed exponentially. The placement must be the more likely of the two.

    log_density  of the placement by the uncertainty of the drive, see `Uncertainty.log_density`; 0 if there is none
    """
    return 1.0 - MEAN_UNMAPPED * (log_density - math.log(MEAN_UNMAPPED))


class _Comparison:
    """Placements of a drive with the fits and the evidence of each."""

    def __init__(
        self,
        new: ScannedDrive,
        old: ScannedMap,
        placements: Sequence[Placement],
        expected: Expectation,
        near: Uncertainty | None,
    ) -> None:
        self._new, self._old, self._placements, self._expected = new, old, placements, expected
        self._fits = [compare_cells(new, old, placement) for placement in placements]
        chances = chances_of_fit(self._fits)
        self._log_densities = [
            0.0 if near is None else near.log_density(new.submaps[-1], p.poses[-1]) for p in placements
        ]
        evidence = [evidence_of(*pair) for pair in zip(self._fits, chances, strict=True)]
        self._log_weights = np.add(evidence, self._log_densities)  # of the placements, by Bayes' theorem
        self._best = int(np.argmax(self._log_weights))
        self._log_unknown = math.log(max(1.0, number_of_places(old.seen_area, near)))
        self._looks_alike = False
        points = [submap.points.points for submap in new.submaps]
        poses = placements[self._best].poses
        costs = [point_cost(old.field, some, pose) for some, pose in zip(points, poses, strict=True)]
        self._fitting = [(fit, known / max(1, len(some))) for (_, fit, known), some in zip(costs, points, strict=True)]
        self.mapped = sum(known for _, _, known in costs) / max(1, sum(map(len, points)))

    @property
    def _unknown(self) -> float:
        """Logarithm of the weight of an unknown place."""
        return self._log_unknown + math.log((1.0 - self._expected.prior) / self._expected.prior)

    def expect_similar_places(self, similarity: float) -> None:
        """Expect that an unknown place resembles the map, with this logarithm of the mean likelihood ratio."""
        self._looks_alike = similarity > self._log_unknown
        self._log_unknown = float(np.logaddexp(self._log_unknown, similarity))

    def decide(self) -> Location:
        """Return the decision on the best placement."""
        count, expected = len(self._new.submaps), self._expected
        odds = [self.odds(row) for row in range(count)]
        certain = [row for row in self.fitting() if odds[row] >= expected.required]
        members = [self.place(row) for row in certain] if self.mapped >= self.least_mapped else []
        decided = Location(count, members, max(odds), expected.required, self.support, "")
        return replace(decided, reason=self.reason(decided))

    @property
    def least_mapped(self) -> float:
        """Least share of what the drive shows that must be mapped at the best placement."""
        return least_mapped(self._log_densities[self._best]) if self._expected.fully_mapped else 0.0

    @property
    def support(self) -> float:
        """Logarithm of the likelihood ratio of any of the placements to an unknown place."""
        return float(np.logaddexp.reduce(self._log_weights)) - self._log_unknown

    def odds(self, submap: int) -> float:
        """Return the logarithm of the odds that a submap is where the best placement has it."""
        pose = self._placements[self._best].poses[submap]
        there = np.array([not are_distinct(pose, other.poses[submap]) for other in self._placements])
        elsewhere = np.logaddexp.reduce([self._unknown, *self._log_weights[~there]])
        return float(np.logaddexp.reduce(self._log_weights[there]) - elsewhere)

    def fitting(self) -> list[int]:
        """Return the submaps whose place was seen, that fit at the best placement, and whose position is determined."""
        rows, informations = [], self._placements[self._best].informations
        for submap, ((fit, known), information) in enumerate(zip(self._fitting, informations, strict=True)):
            determined = position_sigma(_covariance(information)) < MAX_CORRECTED_SIGMA
            if determined and fit >= MIN_LOOP_FIT and known >= MIN_KNOWN:
                rows.append(submap)
        return rows

    def place(self, submap: int) -> PlacedSubmap:
        """Return a submap at the best placement."""
        own, placement = self._new.submaps[submap], self._placements[self._best]
        pose, covariance = placement.poses[submap], _covariance(placement.informations[submap])
        motion = se2.compose(pose, se2.inverse(own.pose))
        walls = matched_walls(self._new, self._old, submap, pose)
        return PlacedSubmap(own.scan.keyframes, pose, covariance, motion, walls, *self._fitting[submap])

    def reason(self, location: Location) -> str:
        """Return the text of the numbers that the best placement is accepted or rejected by."""
        numbers = f"evidence {location.evidence:.1f} of {location.required:.1f} that are required"
        count = len(self._new.submaps)
        if location.accepted:
            return f"{len(location.members)} of its {count} submaps fit in one place only; {numbers}"
        if self._looks_alike:
            return f"it fits, {self._motion(self._best)}, but places of the map look as much alike: {numbers}"
        rivals = [row for row in np.argsort(-self._log_weights)[1:].tolist() if self._log_weights[row] > self._unknown]
        if rivals and location.evidence < location.required:
            strongest = [self._best, *rivals[:MAX_NAMED_RIVALS]]
            places = "; ".join(f"{self._motion(row)} (evidence {self._log_weights[row]:.1f})" for row in strongest)
            unnamed = 1 + len(rivals) - len(strongest)
            more = f" and {unnamed} more" if unnamed else ""
            return f"it fits in several places, {places}{more}: {numbers}"
        fits, share = self._fits[self._best], "none"
        if fits.known.any():
            share = f"{percent(fits.fit[fits.known].mean())} of the {fits.known.sum()} cells"
        place = f"at its best place, {self._motion(self._best)}"
        if self.mapped < self.least_mapped and location.evidence >= location.required:
            least = "requires " + percent(self.least_mapped) if self.least_mapped <= 1.0 else "no share suffices there"
            mapped = f"only {percent_apart(self.mapped, self.least_mapped)} of what it shows are mapped ({least})"
            return f"{place}, {mapped}: {numbers}"
        if location.evidence >= location.required:
            return f"{place}, {share} fit, but no submap alone fits and has a certain position: {numbers}"
        return f"{place}, {share} fit, as they may where it only looks alike: {numbers}"

    def _motion(self, row: int) -> str:
        """Return the pose of the session's map in the other one as text, that of the submap in its middle."""
        middle = len(self._new.submaps) // 2
        motion = se2.compose(self._placements[row].poses[middle], se2.inverse(self._new.submaps[middle].pose))
        return f"x {motion[0]:z.1f} m, y {motion[1]:z.1f} m, {math.degrees(motion[2]):z.0f} degrees"


def _covariance(information: Floats) -> Floats:
    """Return the covariance (3, 3) of a match, with the distortion of the submap; `information` may be singular."""
    return np.asarray(np.linalg.inv(information + NO_PRIOR) + np.diag(DISTORTION_SIGMAS**2))
