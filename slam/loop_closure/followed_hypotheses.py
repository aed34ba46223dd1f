"""The hypotheses that loop closure follows from look to look, and those it has given up, for reports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from .criteria import MIN_KNOWN, MIN_SUPPORT, admits_closure, differ, fits, is_determined
from .decision import LoopDecision
from .look import Look
from .look_back import look_back
from .loop_hypothesis import LoopHypothesis
from .votes import Vote

# Metres of driving after the last support for which a hypothesis is followed. Origin: chosen; not measured.
MEMORY = 40.0


class FollowedHypotheses:
    """Hypotheses that are followed, each with at least one look that supports it."""

    def __init__(self, hypotheses: Iterable[LoopHypothesis] = (), given_up: Iterable[LoopHypothesis] = ()) -> None:
        """Follow copies of some hypotheses; those `given_up` are to be reported."""
        self._followed = [hypothesis.copy() for hypothesis in hypotheses]
        self._given_up = list(given_up)

    def __iter__(self) -> Iterator[LoopHypothesis]:
        return iter(self._followed)

    def copy(self) -> FollowedHypotheses:
        """Return an independent copy."""
        return FollowedHypotheses(self._followed, self._given_up)

    def clear(self) -> None:
        """Discard all: the map has been corrected. Rivals of the loop that was closed are not reported."""
        self._followed = []

    def expire(self, now: float) -> None:
        """Give up the hypotheses that no look of the last MEMORY metres supports; `now` is the distance driven."""
        self._given_up += [h for h in self._followed if now - h.support[-1].travelled >= MEMORY]
        self._followed = [h for h in self._followed if now - h.support[-1].travelled < MEMORY]

    def count(
        self, look: Look, tested: Sequence[tuple[LoopHypothesis, Vote]], least: float, least_of_known: float
    ) -> None:
        """Let a look support or contradict hypotheses.

        tested          hypotheses with the votes of the look where they have the robot
        least           quality of a match that supports its hypothesis
        least_of_known  the same without what the look proposes; a match with less contradicts its hypothesis
        """
        for hypothesis, vote in tested:
            quality = vote.match.quality if fits(vote.match) else -np.inf
            if quality >= least and is_determined(vote.match):
                _support(hypothesis, look, vote)
                if len(hypothesis.support) == MIN_SUPPORT:
                    look_back(hypothesis, look, MEMORY)
            elif quality < least_of_known and vote.match.known >= MIN_KNOWN:
                hypothesis.contradictions.append(look.travelled)

    def propose(self, look: Look, votes: Iterable[Vote]) -> None:
        """Follow new hypotheses: the motions of some votes of a look, which no hypothesis is about."""
        for vote in votes:
            hypothesis = LoopHypothesis(vote.motion)
            _support(hypothesis, look, vote)
            self._followed.append(hypothesis)

    def merge_equal(self, look: Look, *, has_returned: bool) -> None:
        """Keep one, that with the most support, of the hypotheses that have converged to the same motion.

        One that has converged to the estimate is given up if the look agrees with that, so that the robot
        `has_returned`: nothing has to be corrected.
        """
        kept = list[LoopHypothesis]()
        for hypothesis in sorted(self._followed, key=lambda h: -len(h.support)):
            others = [*(other.motion for other in kept), *([np.zeros(3)] if has_returned else [])]
            if all(differ(look, hypothesis.motion, motion) for motion in others):
                kept.append(hypothesis)
        self._followed = kept

    def note_rejection(self, decision: LoopDecision) -> None:
        """Keep, for reports, why the loop of a hypothesis is not closed."""
        for hypothesis in self._followed:
            if np.array_equal(hypothesis.motion, decision.correction):
                hypothesis.rejection = decision

    def take_rejected(self, *, ended: bool) -> list[LoopDecision]:
        """Return the decisions against those given up since the last call; against all if the run has `ended`."""
        reported = [*self._given_up, *(self._followed if ended else ())]
        self._given_up = []
        return [h.rejection for h in reported if h.rejection is not None]


def _support(hypothesis: LoopHypothesis, look: Look, vote: Vote) -> None:
    """Add the match of a look to the support of a hypothesis, which becomes the motion that follows from the match."""
    hypothesis.motion = vote.motion
    hypothesis.support.append(look.loop_match(vote.old, vote.match))
    hypothesis.admitted = admits_closure(look, vote.old, vote.match.pose)
