"""Where one session's map lies in another's: pieces of it looked for there one by one, and what most of them say.

A piece alone may be mistaken for another that looks like it. That several, which rest on different walls, are mistaken
in a way that fits together is what a wrong join would take; so that many must agree, and few may differ.
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
from .fragments import fragments

SAME_PLACE, SAME_HEADING = 1.0, np.radians(5.0)  # by which pieces may differ: each map is bent in its own way
LEAST_INDEPENDENT = 3  # pieces that agree, each on walls of its own
LEAST_OWN = 5  # walls of a piece on which none that counts rests: as many as it takes to recognise a place at all
MOST_DISSENT = 0.2  # share of the pieces that were recognised that may be so elsewhere


@dataclass(frozen=True, slots=True, eq=False)
class Recognised:
    """A piece of a session, seen from its `keyframes`, and where it was `found`; the last is at `pose` in its map."""

    keyframes: range
    pose: se2.Pose
    found: Relocalisation


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """What the pieces of a session say of where it lies.

    looked_for   pieces
    recognised   of them
    members      the largest number that fit together
    independent  of those, that rest on walls of their own
    """

    looked_for: int
    recognised: int
    members: Sequence[Recognised]
    independent: int

    @property
    def accepted(self) -> bool:
        """Whether that is believed."""
        enough = self.independent >= LEAST_INDEPENDENT
        return enough and self.recognised - len(self.members) <= MOST_DISSENT * self.recognised

    @property
    def reason(self) -> str:
        """Why it is believed or not."""
        if not self.recognised:
            return f"none of {self.looked_for} pieces of it is recognised"
        told = f"{len(self.members)} of {self.looked_for} pieces of it agree, {self.independent} on walls of their own"
        return f"{told}, {self.recognised - len(self.members)} say otherwise"


def locate(mapper: Mapper, drive: ScanHistory, index: MapIndex) -> Agreement:
    """Look for every piece of a session in another's map."""
    looked_for, recognised = 0, []
    for keyframes, fragment in fragments(mapper, drive):
        looked_for += 1
        found = relocalise(fragment, index)
        if found is not None and found.verdict.accepted:
            recognised.append(Recognised(keyframes, fragment.pose, found))
    members = largest_agreement(recognised)
    return Agreement(looked_for, len(recognised), members, independent(members))


def largest_agreement(recognised: Sequence[Recognised]) -> list[Recognised]:
    """Those that fit with one of them, for the one with which most do."""
    poses = np.array([some.pose for some in recognised]).reshape(-1, 3)
    places = np.array([some.found.pose for some in recognised]).reshape(-1, 3)
    best = np.zeros(len(recognised), dtype=bool)
    for some in recognised:
        fits = _fits(se2.compose(some.found.motion, poses).reshape(-1, 3), places)
        best = fits if fits.sum() > best.sum() else best
    return [some for some, fits in zip(recognised, best, strict=True) if fits]


def _fits(expected: Floats, found: Floats) -> NDArray[np.bool_]:
    difference = se2.between(expected, found).reshape(-1, 3)
    near = np.hypot(difference[:, 0], difference[:, 1]) < SAME_PLACE
    return np.asarray(near & (np.abs(difference[:, 2]) < SAME_HEADING))


def independent(members: Sequence[Recognised]) -> int:
    """How many rest on enough walls on which no other that counts does."""
    known: set[int] = set()
    count = 0
    for some in sorted(members, key=lambda member: -member.found.verdict.score):
        own = set(some.found.pairs[:, 0].tolist()) - known
        if len(own) >= LEAST_OWN:
            known |= own
            count += 1
    return count
