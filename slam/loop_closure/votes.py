"""Votes of a look: its matches with old places, and the motions of the robot in the map that they imply."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from drivers import se2

from .criteria import admits_closure, differ, fits, is_determined
from .look import Look
from .loop_hypothesis import LoopHypothesis
from .submap_search import SubmapMatch

# Share of the best match's quality from which another one at the same look is supported too.
# Origin: chosen; not measured.
RIVAL_QUALITY = 0.9

Search: TypeAlias = Callable[[Look, int], Sequence[SubmapMatch]]
"""Returns the matches of a look with the place around an old keyframe."""


@dataclass(frozen=True, slots=True, eq=False)
class Vote:
    """Match of a look with the place around an old keyframe, and the motion [x, y, heading] in the map that follows."""

    old: int
    match: SubmapMatch
    motion: se2.Pose


Tested: TypeAlias = tuple[LoopHypothesis, Vote | None]
"""A hypothesis, and the match where it has the robot, if a place was mapped there."""


def find_votes(look: Look, places: Sequence[int], search: Search) -> list[Vote]:
    """Return the votes for distinct motions, those with the best matches first."""
    found = [(old, match) for old in places for match in search(look, old)]
    votes = [Vote(old, m, look.motion(old, m.pose)) for old, m in found if fits(m) and is_determined(m)]
    distinct: list[Vote] = []
    for vote in sorted(votes, key=lambda vote: -vote.match.score):
        if all(differ(look, vote.motion, other.motion) for other in distinct):
            distinct.append(vote)
    return distinct


def with_better_matches(look: Look, tested: Sequence[Tested], found: Sequence[Vote]) -> list[Tested]:
    """Return tested hypotheses with the best match at the place of each, which may be one that the search has found.

    The match near a hypothesis may be a local minimum, such as the next door frame of a corridor.
    """
    better = list[Tested]()
    for hypothesis, vote in tested:
        if vote is not None:
            same = [vote, *(other for other in found if not differ(look, vote.motion, other.motion))]
            vote = max(same, key=lambda vote: vote.match.score)
        better.append((hypothesis, vote))
    return better


def corrects_estimate(look: Look, vote: Vote) -> bool:
    """Return True if a vote of the match that starts at the estimate implies a correction of it."""
    if not fits(vote.match) or not is_determined(vote.match) or look.agrees(vote.old, vote.match):
        return False
    return look.admits(vote.old, vote.match.pose) or not differ(look, vote.motion, np.zeros(3))


def is_recognised(look: Look, tested: Sequence[Tested], found: Sequence[Vote]) -> bool:
    """Return True if the look fits an old place at a pose for which the estimate's uncertainty admits a closure.

    A place that fits clearly less than another one does not count: a corridor fits badly all along itself.
    """
    fitting = [*found, *(vote for _, vote in tested if vote is not None and fits(vote.match))]
    least = least_quality(fitting)
    good = [vote for vote in fitting if vote.match.quality >= least]
    return any(admits_closure(look, vote.old, vote.match.pose) for vote in good)


def least_quality(votes: Sequence[Vote]) -> float:
    """Return the quality that a vote of a look needs to count beside the best of its votes."""
    return RIVAL_QUALITY * max((vote.match.quality for vote in votes), default=0.0)
