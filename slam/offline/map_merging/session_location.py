"""Locate a session in another session's map: decide on one placement of all its submaps.

A single submap may be mistaken for a similar place, and in a corridor of equal doors each of them is. All submaps
together are in one place only, which is decided on by the evidence of all cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2

from ...formatting import percent
from ...geometry.segments import Floats, Integers
from ...loop_closure.criteria import MAX_MATCH_SIGMA, MIN_KNOWN, MIN_LOOP_FIT
from ...loop_closure.submap_search import DISTINCT_SHIFT, DISTINCT_TURN, DISTORTION_SIGMAS, NO_PRIOR
from ...matching.point_matcher import point_cost
from .evidence import HIT_PROBABILITIES, CellFits, chance_of_fit, compare_cells, evidence_of
from .placements import Placement, find_placements, matched_walls
from .scanned_map import ScannedMap

ERROR_PROBABILITY = 0.01
"""Largest probability of a wrong merge, given that the session is in the map or not with equal probability before."""
MAX_CHANCE = float(HIT_PROBABILITIES[-1])
"""Largest probability that a cell fits."""
MAX_NAMED_RIVALS = 3
"""Rival placements that a refusal names."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedSubmap:
    """Submap that was placed in another map.

    keyframes   of the submap
    pose        (3,) of its last keyframe in the other map
    covariance  (3, 3) of the pose from the points of the submap alone, in the pose's frame
    motion      [x, y, heading] of its own session's map in the other map, according to this submap
    walls       landmark ids (n, 2) of coinciding walls: in the other map, in its own
    """

    keyframes: range
    pose: se2.Pose
    covariance: Floats
    motion: se2.Pose
    walls: Integers


@dataclass(frozen=True, slots=True, eq=False)
class SessionLocation:
    """Decision on the placement of a session in another map.

    submaps   number of submaps
    members   submaps that fit at the best placement and at no rival, which the maps are joined by
    evidence  for the best placement, without what also fits at rivals, nats
    required  evidence that is required, nats
    reason    text of the numbers that the placement is accepted or rejected by
    """

    submaps: int
    members: Sequence[PlacedSubmap]
    evidence: float
    required: float
    reason: str

    @property
    def accepted(self) -> bool:
        """True if the evidence suffices."""
        return bool(self.members) and self.evidence >= self.required


def locate_session(new: ScannedMap, old: ScannedMap) -> SessionLocation:
    """Search for a session in the map of another one, and decide on its placement.

    The placement with most evidence is accepted if its evidence is at least log(n / p) with the number n of places
    where the session could be and p = ERROR_PROBABILITY: by Bayes' theorem, it is wrong with probability p if it is as
    likely before that the session is in the map as that it is not. Another placement is a rival if the evidence of the
    submaps that fit there, and are elsewhere at the best placement, exceeds log(n p), so that it is not excluded with
    the same certainty. What fits at a rival is no evidence, and the maps are not joined by it. So a session that fits
    in several places is refused, however well it fits in each.
    """
    placements = find_placements(new, old)
    places = math.log(max(1.0, number_of_places(old.seen_area)))
    required, excluded = places - math.log(ERROR_PROBABILITY), places + math.log(ERROR_PROBABILITY)
    count = len(new.submaps)
    if not placements:
        return SessionLocation(count, (), 0.0, required, f"none of its {count} submaps lies on walls of it")
    comparison = _Comparison(new, old, placements)
    ambiguous: set[int] = set()
    rivals = []
    for rival in comparison.others():
        displaced = placements[comparison.best].differs(placements[rival])
        fitting = [row for row in comparison.fitting(rival) if row in displaced]
        evidence = comparison.evidence(rival, fitting) if fitting else 0.0
        if fitting and evidence > excluded:
            ambiguous.update(fitting)
            rivals.append((evidence, rival))
    members = [comparison.place(row) for row in comparison.fitting(comparison.best) if row not in ambiguous]
    evidence = comparison.evidence(comparison.best, range(count), [rival for _, rival in rivals])
    decided = SessionLocation(count, members, evidence, required, "")
    return replace(decided, reason=comparison.reason(decided, rivals))


def number_of_places(area: float) -> float:
    """Return how many places a map that has seen `area` square metres has, those that the search distinguishes."""
    return area / (2.0 * DISTINCT_SHIFT) ** 2 * math.pi / DISTINCT_TURN


class _Comparison:
    """Placements of a session with the fits and the evidence of each."""

    def __init__(self, new: ScannedMap, old: ScannedMap, placements: Sequence[Placement]) -> None:
        self._new, self._old, self._placements = new, old, placements
        self.fits = [compare_cells(new, old, placement, range(len(new.submaps))) for placement in placements]
        self._evidence = [evidence_of(fits, self._chance(row)) for row, fits in enumerate(self.fits)]
        self.best = int(np.argmax(self._evidence))

    def _chance(self, row: int) -> Floats:
        """Return the chance (n,) of each cell to fit, from all placements but one."""
        blank = CellFits(np.zeros_like(self.fits[row].fit), np.zeros_like(self.fits[row].known))
        return chance_of_fit([*self.fits[:row], *self.fits[row + 1 :], blank])

    def others(self) -> list[int]:
        """Return the placements but the best one."""
        return [row for row in range(len(self.fits)) if row != self.best]

    def evidence(self, row: int, submaps: Sequence[int], rivals: Sequence[int] = ()) -> float:
        """Return the evidence of some submaps for a placement; see `evidence_of`.

        A cell that also fits at a rival that is possible is no evidence: so large is its chance to fit there.
        """
        compared, chance = compare_cells(self._new, self._old, self._placements[row], submaps), self._chance(row)
        for fits in (self.fits[rival] for rival in rivals):
            chance = np.maximum(chance, np.where(fits.known, np.minimum(fits.fit, compared.fit), 0.0))
        return evidence_of(compared, np.minimum(chance, MAX_CHANCE))

    def fitting(self, row: int) -> list[int]:
        """Return the submaps whose place was seen, that fit there, and whose position is determined."""
        placement, rows = self._placements[row], []
        for submap, (pose, information) in enumerate(zip(placement.poses, placement.informations, strict=True)):
            points = self._new.submaps[submap].points.points
            _, fit, known = point_cost(self._old.field, points, pose)
            covariance = _covariance(information)
            determined = np.linalg.eigvalsh(covariance[:2, :2])[-1] < MAX_MATCH_SIGMA**2
            if determined and fit >= MIN_LOOP_FIT and known >= MIN_KNOWN * len(points):
                rows.append(submap)
        return rows

    def place(self, submap: int) -> PlacedSubmap:
        """Return a submap at the best placement."""
        own, placement = self._new.submaps[submap], self._placements[self.best]
        pose, covariance = placement.poses[submap], _covariance(placement.informations[submap])
        motion = se2.compose(pose, se2.inverse(own.pose))
        walls = matched_walls(self._new, self._old, submap, pose)
        return PlacedSubmap(own.keyframes, pose, covariance, motion, walls)

    def reason(self, location: SessionLocation, rivals: Sequence[tuple[float, int]]) -> str:
        """Return the text of the numbers that the best placement is accepted or rejected by."""
        numbers = f"evidence {location.evidence:.1f} of {location.required:.1f} that are required"
        count, agreeing = len(self._new.submaps), len(location.members)
        if location.accepted:
            return f"{agreeing} of its {count} submaps fit in one place only; {numbers}"
        if rivals and self._evidence[self.best] >= location.required:
            strongest = [(self._evidence[self.best], self.best), *sorted(rivals, reverse=True)][: 1 + MAX_NAMED_RIVALS]
            places = "; ".join(f"{self._motion(row)} (evidence {evidence:.1f})" for evidence, row in strongest)
            unnamed = 1 + len(rivals) - len(strongest)
            more = f" and {unnamed} more" if unnamed else ""
            only = f"{agreeing} of its {count} submaps fit in one of them only: {numbers}"
            return f"it fits in several places, {places}{more}; {only}"
        fits, share = self.fits[self.best], "none"
        if fits.known.any():
            share = f"{percent(fits.fit[fits.known].mean())} of the {fits.known.sum()} cells"
        place = f"at its best place, {self._motion(self.best)}"
        return f"{place}, {share} fit, as they may where it only looks alike: {numbers}"

    def _motion(self, row: int) -> str:
        """Return the pose of the session's map in the other one as text, that of the submap in its middle."""
        middle = len(self._new.submaps) // 2
        motion = se2.compose(self._placements[row].poses[middle], se2.inverse(self._new.submaps[middle].pose))
        return f"x {motion[0]:.1f} m, y {motion[1]:.1f} m, {math.degrees(motion[2]):.0f} degrees"


def _covariance(information: Floats) -> Floats:
    """Return the covariance (3, 3) of a match, with the distortion of the submap; `information` may be singular."""
    return np.asarray(np.linalg.inv(information + NO_PRIOR) + np.diag(DISTORTION_SIGMAS**2))
