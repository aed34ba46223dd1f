"""Loop closure by agreement: follow each possible correction of the estimate over several looks at old places.

Every few metres the points of the last keyframes are matched with the old places where the robot may be by the
uncertainty of the estimate (see `look`). Each match is a hypothesis: a motion that would move the robot onto the old
map. One match may be wrong, as places look alike, so each later look tests all hypotheses again. A loop is proposed if
no rival has as much support and the looks extend over as many metres of driving as the robot may be off; whether it is
closed is decided by the evidence of the drive, see `criteria` and `recognition.loop_evidence`. Looks count only if they
are pairwise consistent (Mangelson et al., 2018): the motion between two of them over the old map must be that of the
estimate. The estimate itself is tested, too: if it agrees with the match that starts there, the robot has returned, and
nothing is corrected. If it does not, this match is a hypothesis like any other.

The uncertainty of the estimate may be too small itself. So if enough looks contradict the estimate, it is in doubt: a
hypothesis may then also be accepted if errors that are the same all along the drive explain it, see
`RelativeUncertainty`. If no place is recognised within the uncertainty of the estimate, places are also searched where
such errors may have led the robot. Looks at a place where nothing was mapped do not contradict the estimate: the place
may only look like an old one.

Parts of the map that are not connected are joined in the same way. Here the estimate is the motion between the parts
that odometry has measured. No look supports it as such: a match near it is a hypothesis like any other. If looks at
what the other part has seen fit nowhere within its uncertainty, it is refuted: see `LoopAgreement.refuted`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers import se2

from ..localisation.local_field import LocalField
from ..mapping.mapper import Mapper
from .criteria import MIN_INDEPENDENT, MIN_KNOWN, differ, fits, is_determined
from .decision import LoopDecision, LoopMatch
from .followed_hypotheses import MEMORY, FollowedHypotheses
from .judgement import Judgement
from .look import SEARCH_INTERVAL, Look
from .loop_hypothesis import LoopAgreementState
from .rejection import MIN_REPORTED_SUPPORT, rejected
from .returns import Return
from .submaps import Submaps
from .votes import (
    Search,
    Vote,
    Votes,
    best_at_place,
    corrects_estimate,
    find_votes,
    is_good,
    is_recognised,
    least_quality,
    vote_at,
)

# Old places that are searched at a look. Origin: chosen, for time; within MEMORY 160 of them are searched.
MAX_PLACES = 8
# Places beyond the estimate's uncertainty that are searched at a look. Origin: chosen, for time; within MEMORY 40 of
# them are searched.
DOUBTED_PLACES = 2


class LoopAgreement:
    """Search for loop closures: hypotheses of the last metres, looks for and against the estimate, and new places.

    search  returns the matches of a look at a place
    joins   true if the places are in parts of the map that are not connected with the last keyframe
    """

    def __init__(self, search: Search = Look.search, *, joins: bool = False) -> None:
        self._search_place, self._joins = search, joins
        self._candidates = 0
        self.returns: list[Return] = []
        """Looks of this run that agree with the estimate, for reports."""
        self._restore(LoopAgreementState(), Submaps())

    def _restore(self, state: LoopAgreementState, submaps: Submaps) -> None:
        self._last_search, self._submaps = state.last_search, submaps
        self._searched = dict(state.searched)  # metres driven up to the last search of each place
        self._returned_at = list(state.returned_at)  # metres driven up to each look that agrees with the estimate
        self._contradictions = list(state.contradictions)  # metres driven up to each look that contradicts the estimate
        self._hypotheses = FollowedHypotheses(state.hypotheses)
        self._candidates, self._retracted = state.candidates, list(state.retracted)

    def __deepcopy__(self, memo: dict[int, object]) -> LoopAgreement:
        """Return an independent copy; matches and submaps are never changed and are shared."""
        other = LoopAgreement(self._search_place, joins=self._joins)
        other._restore(self.state, self._submaps.copy())
        other._hypotheses, other.returns = self._hypotheses.copy(), list(self.returns)
        return other

    def return_at(self, keyframe: int) -> LoopMatch | None:
        """Return the match of the look at a keyframe with an old place, if it agrees with the estimate."""
        match = self.returns[-1].match if self.returns else None
        return match if match is not None and match.keyframe == keyframe else None

    @property
    def state(self) -> LoopAgreementState:
        """State to be saved."""
        return LoopAgreementState(
            self._last_search,
            self._submaps.places,
            tuple(self._searched.items()),
            tuple(self._returned_at),
            tuple(self._contradictions),
            tuple(hypothesis.copy() for hypothesis in self._hypotheses),
            self._candidates,
            tuple(self._retracted),
        )

    def restore(self, state: LoopAgreementState, local_field: LocalField) -> None:
        """Continue from a saved state; `local_field` has the points of all keyframes."""
        self._restore(state, Submaps(state.places, local_field))

    def clear(self) -> None:
        """Discard all hypotheses and what looks have shown: the map has been corrected."""
        self._hypotheses.clear()
        self._searched, self._returned_at, self._contradictions = {}, [], []
        self._submaps = Submaps()

    def free_submaps(self) -> None:
        """Free the submaps of old places, some megabytes. They are built again if a place is searched."""
        self._submaps = Submaps()

    @property
    def correction_likely(self) -> bool:
        """True if the last look contradicted the estimate and supported another hypothesis."""
        contradicted = self._last_search in self._contradictions[-1:]
        return contradicted and any(h.support[-1].travelled == self._last_search for h in self._hypotheses)

    @property
    def unresolved(self) -> tuple[float, ...]:
        """Metres driven up to the looks that put the estimate in doubt, if nothing has resolved this since then."""
        return tuple(self._contradictions) if len(self._contradictions) >= MIN_INDEPENDENT else ()

    @property
    def refuted(self) -> bool:
        """True if looks contradict the motion that odometry measured between two parts, and support none near it.

        The motion is the same all the time, so contradictions count however long ago they were. A hypothesis that its
        uncertainty excludes would never be accepted.
        """
        return len(self._contradictions) >= MIN_INDEPENDENT and not any(h.admitted for h in self._hypotheses)

    def number(self, decision: LoopDecision) -> LoopDecision:
        """Return a decision with the next number."""
        self._candidates += 1
        return replace(decision, candidate=self._candidates)

    def number_after(self, candidate: int) -> None:
        """Give no number from now on up to that of a decision, which was made elsewhere."""
        self._candidates = max(self._candidates, candidate)

    def take_rejected(self, *, ended: bool = False) -> list[LoopDecision]:
        """Return the decisions against hypotheses that were given up since the last call; all if the run has `ended`.

        Hypotheses that only one look supports, and rivals of a loop that was closed, are not reported.
        """
        return [self.number(decision) for decision in self._hypotheses.take_rejected(ended=ended)]

    def note_rejection(self, decision: LoopDecision) -> None:
        """Keep, for reports, why a loop that looks agree on is not closed."""
        self._hypotheses.note_rejection(decision)

    def exclude(self, motion: se2.Pose) -> None:
        """Reject the motion of a retracted closure from now on."""
        self._retracted.append(motion)

    def search(
        self, mapper: Mapper, local_field: LocalField, among: NDArray[np.bool_] | None = None, *, ended: bool = False
    ) -> LoopDecision | None:
        """Look for the last keyframe's place in old parts of the map; return a closure that looks agree on, if any.

        among  (k,) keyframes whose places are searched; None for all
        ended  true at the end of a run: no look will follow, so few looks are enough, for the evidence of the drive to
               decide on the closure
        """
        now = float(mapper.travelled[mapper.keyframe_count - 1])
        is_due = now > self._last_search if ended else now - self._last_search >= SEARCH_INTERVAL
        decision = self._look(now, mapper, local_field, among) if is_due else None
        if decision is None and ended:
            decision = self._last_accepted(Look(mapper, local_field, self._submaps, among, apart=self._joins))
        return None if decision is None else self.number(decision)

    def _look(
        self, now: float, mapper: Mapper, local_field: LocalField, among: NDArray[np.bool_] | None
    ) -> LoopDecision | None:
        """Look at old places, `now` metres driven; return a closure that looks agree on, if any."""
        self._last_search = now
        self._hypotheses.expire(now)
        self._returned_at = [at for at in self._returned_at if now - at < MEMORY]
        self._searched = {place: at for place, at in self._searched.items() if now - at < MEMORY}
        look = Look(mapper, local_field, self._submaps, among, apart=self._joins)
        places = look.possible_places()
        votes = self._collect_votes(look, places)
        if self._joins:
            self._test_estimate(look, votes)
        elif self._is_estimate_in_doubt(look) and not (self._returned_at or is_recognised(look, votes.all)):
            look = look.doubting_estimate()
            places = look.possible_places()
            votes = votes.with_found(look, self._find(look, places, DOUBTED_PLACES))
        if not places:
            return None
        self._count_votes(look, votes, local_field)
        # A place that has not been searched yet may be a rival.
        all_searched = all(place in self._searched for place in places)
        decision = self._accepted(look) if all_searched else None
        if decision is None or self._is_excluded(look, decision.correction):
            self._note_rejections(look)
            return None
        return decision

    def _is_excluded(self, look: Look, motion: se2.Pose) -> bool:
        """Return True if a motion in the map is that of a retracted closure."""
        return not all(differ(look, motion, retracted) for retracted in self._retracted)

    def _is_estimate_in_doubt(self, look: Look) -> bool:
        """Return True if so many looks of the last MEMORY metres contradict the estimate that it is in doubt.

        The robot is at another place then, however small the covariance of the estimate is.
        """
        return sum(at >= look.travelled - MEMORY for at in self._contradictions) >= MIN_INDEPENDENT

    def _collect_votes(self, look: Look, places: Sequence[int]) -> Votes:
        """Match a look where the estimate and each hypothesis have the robot, and search it at old places."""
        at_estimate = None if self._joins else vote_at(look, np.zeros(3), look.last)
        tested = [(h, vote_at(look, h.motion, h.support[-1].keyframe)) for h in self._hypotheses]
        found = [] if self._is_settled(look, places, at_estimate) else self._find(look, places)
        return Votes(
            None if at_estimate is None else best_at_place(look, at_estimate, found),
            [(hypothesis, best_at_place(look, vote, found)) for hypothesis, vote in tested if vote is not None],
            found,
        )

    def _test_estimate(self, look: Look, votes: Votes) -> None:
        """Count a look as a contradiction of odometry's motion between two parts if it fits nowhere near that.

        Near is within the uncertainty of the motion. A look at what the other part has not seen contradicts nothing.
        """
        vote = vote_at(look, np.zeros(3), look.last)
        if vote is None or vote.match.known < MIN_KNOWN:
            return
        if not is_recognised(look, [vote, *votes.all]):
            self._contradictions.append(look.travelled)

    def _is_settled(self, look: Look, places: Sequence[int], vote: Vote | None) -> bool:
        """Return True if the vote at the estimate agrees with a certain estimate: other places need no search.

        They count as searched then.
        """
        agrees = vote is not None and is_good(vote) and look.agrees(vote.old, vote.match)
        settled = agrees and all(look.uncertainty.is_certain(place) for place in places)
        if settled:
            self._searched |= dict.fromkeys(places, look.travelled)
        return settled

    def _find(self, look: Look, places: Sequence[int], most: int = MAX_PLACES) -> list[Vote]:
        """Return the matches with old places. At most `most` are searched: those whose last search is longest ago."""
        chosen = sorted(places, key=lambda place: self._searched.get(place, -np.inf))[:most]
        self._searched |= dict.fromkeys(chosen, look.travelled)
        return find_votes(look, chosen, self._search_place)

    def _count_votes(self, look: Look, votes: Votes, local_field: LocalField) -> None:
        """Let a look support or contradict the estimate and all hypotheses, and propose new ones.

        What the look proposes has not been tested by another one. If it fits clearly better than a hypothesis, the
        look says nothing about that. It contradicts the estimate, as a return would be decided on at once.
        """
        followed, found = [vote.motion for _, vote in votes.tested], list(votes.found)
        if votes.at_estimate is not None and corrects_estimate(look, votes.at_estimate):
            found.append(votes.at_estimate)
        new = [vote for vote in found if all(differ(look, vote.motion, motion) for motion in followed)]
        others = (votes.at_estimate, *(vote for _, vote in votes.tested))
        known = [vote for vote in others if vote is not None and fits(vote.match)]
        least = least_quality([*new, *known])
        if votes.at_estimate is not None:
            self._judge_estimate(look, votes.at_estimate, least, local_field)
        self._hypotheses.count(look, votes.tested, least, least_quality(known))
        self._hypotheses.propose(look, [vote for vote in new if vote.match.quality >= least])
        self._hypotheses.merge_equal(look, has_returned=self._returned_at[-1:] == [look.travelled])

    def _judge_estimate(self, look: Look, vote: Vote, least: float, local_field: LocalField) -> None:
        """Count a look for or against the estimate, by the match that starts there; link the places if they agree.

        A match that has moved to another place does not show that the robot is where the estimate has it.
        `least` is the quality that it needs.
        """
        determined = is_determined(vote.match)
        is_elsewhere = determined and differ(look, vote.motion, np.zeros(3))
        if fits(vote.match) and vote.match.quality >= least and not is_elsewhere:
            if determined and look.agrees(vote.old, vote.match):
                local_field.link(vote.old, look.last)
                self._returned_at.append(look.travelled)
                self.returns.append(Return.of(look, vote.old, vote.match))
                self._contradictions = []
        elif vote.match.known >= MIN_KNOWN:
            self._contradictions.append(look.travelled)

    def _note_rejections(self, look: Look) -> None:
        """Keep, for reports, why the hypotheses that the look supports are not accepted."""
        judgement = self._judgement(look)
        for hypothesis in self._hypotheses:
            if len(hypothesis.support) < MIN_REPORTED_SUPPORT or hypothesis.support[-1].keyframe != look.last:
                continue
            decision, equal = judgement.decision(hypothesis)
            was_retracted = self._is_excluded(look, hypothesis.motion)
            hypothesis.rejection = rejected(decision, equal, was_retracted)

    def _accepted(self, look: Look) -> LoopDecision | None:
        """Return a closure that looks agree on, if any. Looks that contradict the estimate put its errors in doubt."""
        decision = self._judgement(look).accepted()
        if decision is None and not self._joins and self._is_estimate_in_doubt(look):
            decision = self._judgement(look.doubting_estimate()).accepted()
        return decision

    def _last_accepted(self, look: Look) -> LoopDecision | None:
        """Return a closure that few looks agree on at the end of a run, if any."""
        decision = self._judgement(look).accepted(ended=True)
        return None if decision is None or self._is_excluded(look, decision.correction) else decision

    def _judgement(self, look: Look) -> Judgement:
        """Return the judgement of all hypotheses after a look."""
        return Judgement(
            look,
            self._contradictions,
            tuple(self._hypotheses),
            self._returned_at,
            self._joins,
            self._is_estimate_in_doubt(look),
        )
