"""Locate a session in another session's map: relocalise its submaps one by one and find their consensus.

A single submap may be mistaken for a similar place. A wrong merge would take several submaps with different walls,
mistaken in a way that is geometrically consistent. Therefore many submaps must agree, and few may disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ...estimation.refinement.scan_history import ScanHistory
from ...geometry.segments import Floats
from ...loop_closure.relocalisation import MapIndex, Relocalisation, relocalise
from ...mapping.mapper import Mapper
from .submaps import split_into_submaps

MAX_SUBMAP_DISTANCE = 1.0
"""Metres between two submaps' positions that agree: both maps are distorted by drift."""
MAX_SUBMAP_TURN = np.radians(5.0)
"""Radians between two submaps' headings that agree."""
MIN_INDEPENDENT = 3
"""Agreeing submaps with walls of their own that a consensus needs."""
MIN_OWN_WALLS = 5
"""Walls that no other independent submap is matched to, for a submap to be independent: as many as relocalisation
needs."""
MAX_DISSENT = 0.2
"""Share of the recognised submaps that may disagree with the consensus."""


@dataclass(frozen=True, slots=True, eq=False)
class SubmapMatch:
    """Submap that was relocalised in another map.

    keyframes       of the submap
    pose            (3,) of its last keyframe in its own session's map
    relocalisation  where it was found in the other map
    """

    keyframes: range
    pose: se2.Pose
    relocalisation: Relocalisation


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """Agreement of a session's submaps on its pose in another map.

    submaps      number of submaps
    recognised   number of submaps that were relocalised
    members      largest set of matches that agree with one of them
    independent  number of members with walls of their own
    ambiguous    number of submaps that fit in several places, as along a corridor of equal doors
    """

    submaps: int
    recognised: int
    members: Sequence[SubmapMatch]
    independent: int
    ambiguous: int = 0

    @property
    def accepted(self) -> bool:
        """True if enough independent submaps agree and few disagree."""
        enough = self.independent >= MIN_INDEPENDENT
        return enough and self.recognised - len(self.members) <= MAX_DISSENT * self.recognised

    @property
    def reason(self) -> str:
        """Numbers that the consensus is accepted or rejected by."""
        if not self.recognised:
            several = f", as {self.ambiguous} fit in several places" if self.ambiguous else ""
            return f"none of its {self.submaps} submaps is recognised{several}"
        agree = f"{len(self.members)} of its {self.submaps} submaps agree, {self.independent} of them on separate walls"
        return f"{agree}; {self.recognised - len(self.members)} disagree"


def locate_session(mapper: Mapper, history: ScanHistory, index: MapIndex) -> Consensus:
    """Relocalise every submap of a session in another map and return their consensus."""
    submaps, ambiguous, matches = 0, 0, []
    for keyframes, submap in split_into_submaps(mapper, history):
        submaps += 1
        relocalisation = relocalise(submap, index)
        if relocalisation is None:
            continue
        if relocalisation.verdict.accepted:
            matches.append(SubmapMatch(keyframes, submap.pose, relocalisation))
        else:
            ambiguous += relocalisation.verdict.plausible
    members = find_largest_consensus(matches)
    return Consensus(submaps, len(matches), members, count_independent(members), ambiguous)


def find_largest_consensus(matches: Sequence[SubmapMatch]) -> list[SubmapMatch]:
    """Return the largest set of matches that agree with the motion of one of them."""
    poses = np.array([match.pose for match in matches]).reshape(-1, 3)
    found = np.array([match.relocalisation.pose for match in matches]).reshape(-1, 3)
    best = np.zeros(len(matches), dtype=bool)
    for match in matches:
        agrees = _agrees(se2.compose(match.relocalisation.motion, poses).reshape(-1, 3), found)
        best = agrees if agrees.sum() > best.sum() else best
    return [match for match, agrees in zip(matches, best, strict=True) if agrees]


def _agrees(expected: Floats, found: Floats) -> NDArray[np.bool_]:
    """Return for each of n poses (n, 3) True if it was found near the expected pose."""
    difference = se2.between(expected, found).reshape(-1, 3)
    near = np.hypot(difference[:, 0], difference[:, 1]) < MAX_SUBMAP_DISTANCE
    return np.asarray(near & (np.abs(difference[:, 2]) < MAX_SUBMAP_TURN))


def count_independent(members: Sequence[SubmapMatch]) -> int:
    """Count members that are matched to enough walls that no member counted before is matched to, best score first."""
    used: set[int] = set()
    count = 0
    for match in sorted(members, key=lambda member: -member.relocalisation.verdict.score):
        own = set(match.relocalisation.pairs[:, 0].tolist()) - used
        if len(own) >= MIN_OWN_WALLS:
            used |= own
            count += 1
    return count
