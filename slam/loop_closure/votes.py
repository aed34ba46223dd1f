"""Votes of a look: its matches with old places, and the motions of the robot in the map that they imply."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from .criteria import admits_closure, differ, fits, is_determined
from .look import Look
from .loop_hypothesis import LoopHypothesis
from .submap_search import SubmapMatch

# Share of the best match's quality from which another one at the same look is supported too.
# Origin: chosen; not measured.
RIVAL_QUALITY = 0.9

Search: TypeAlias = Callable[[Look, int], Sequence[SubmapMatch]]
"""Returns the matches of a look with the place around an old keyframe."""


@immutable
class Vote:
    """Match of a look with the place around an old keyframe, and the motion [x, y, heading] in the map that follows."""

    old: int
    match: SubmapMatch
    motion: se2.Pose


@immutable
class Votes:
    """All votes of a look.

    at_estimate  that of the match which starts where the estimate has the robot; None if no place was mapped there, or
                 if parts of the map are to be joined
    tested       hypotheses with the votes of the matches that start where they have the robot
    found        those of the search at old places
    """

    at_estimate: Vote | None
    tested: Sequence[tuple[LoopHypothesis, Vote]]
    found: Sequence[Vote]

    @property
    def all(self) -> list[Vote]:
        """All votes in one list."""
        at_estimate = [] if self.at_estimate is None else [self.at_estimate]
        return [*self.found, *at_estimate, *(vote for _, vote in self.tested)]

    def with_found(self, look: Look, more: Iterable[Vote]) -> Votes:
        """Return these votes together with those of another search, `more`, that lead to other places."""
        new = [vote for vote in more if all(differ(look, vote.motion, other.motion) for other in self.found)]
        return replace(self, found=[*self.found, *new])


def vote_at(look: Look, motion: se2.Pose, since: int) -> Vote | None:
    """Return the vote of a look where a motion in the map has the robot; None if no place was mapped there.

    since  keyframe of the last look that supports the motion, see `Look.test`
    """
    old = look.place_at(se2.compose(motion, look.pose))
    return None if old is None else _vote(look, old, look.test(old, motion, since))


def vote_in_view(look: Look, motion: se2.Pose) -> Vote | None:
    """Return the vote of a look with the place that it sees from where a motion in the map has the robot, if any."""
    old = look.place_in_view(se2.compose(motion, look.pose))
    return None if old is None else _vote(look, old, look.test(old, motion, look.last))


def _vote(look: Look, old: int, match: SubmapMatch) -> Vote:
    """Return the vote for the motion that follows from the match of a look with an old place."""
    return Vote(old, match, look.motion(old, match.pose))


def is_good(vote: Vote) -> bool:
    """Return True if the match of a vote fits and determines the position."""
    return fits(vote.match) and is_determined(vote.match)


def find_votes(look: Look, places: Sequence[int], search: Search) -> list[Vote]:
    """Return the votes for distinct motions, those with the best matches first."""
    found = [(old, match) for old in places for match in search(look, old)]
    votes = [_vote(look, old, match) for old, match in found]
    distinct: list[Vote] = []
    for vote in sorted(filter(is_good, votes), key=lambda vote: -vote.match.score):
        if all(differ(look, vote.motion, other.motion) for other in distinct):
            distinct.append(vote)
    return distinct


def best_at_place(look: Look, vote: Vote, found: Iterable[Vote]) -> Vote:
    """Return a vote, or that one of the search at the same place that matches better.

    The match near a hypothesis may be a local minimum, such as the next door frame of a corridor.
    """
    same = [vote, *(other for other in found if not differ(look, vote.motion, other.motion))]
    return max(same, key=lambda vote: vote.match.score)


def corrects_estimate(look: Look, vote: Vote) -> bool:
    """Return True if a vote of the match that starts at the estimate implies a correction of it."""
    if not is_good(vote) or look.agrees(vote.old, vote.match):
        return False
    return look.admits(vote.old, vote.match.pose) or not differ(look, vote.motion, np.zeros(3))


def is_recognised(look: Look, votes: Iterable[Vote]) -> bool:
    """Return True if the look fits an old place at a pose for which the estimate's uncertainty admits a closure.

    A place that fits clearly less than another one does not count: a corridor fits badly all along itself.
    """
    fitting = [vote for vote in votes if fits(vote.match)]
    least = least_quality(fitting)
    return any(vote.match.quality >= least and admits_closure(look, vote.old, vote.match.pose) for vote in fitting)


def least_quality(votes: Sequence[Vote]) -> float:
    """Return the quality that a vote of a look needs to count beside the best of its votes."""
    return RIVAL_QUALITY * max((vote.match.quality for vote in votes), default=0.0)
