"""Judgement of the hypotheses of loop closure after a look: which one is accepted, and why the others are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .criteria import confirm, prevails, qualifies, support_checks
from .decision import Check, LoopDecision
from .look import Look
from .loop_hypothesis import LoopHypothesis
from .submap_search import SUBMAP_LENGTH


@dataclass(frozen=True, slots=True)
class Judgement:
    """Judgement of hypotheses by their support, the contradictions and their rivals.

    look            last look
    contradictions  metres driven up to each look that contradicts the estimate
    hypotheses      with at least one look each that supports them
    returned_at     metres driven up to each look that agrees with the estimate
    joins           true if the places are in parts of the map that are not connected with the last keyframe
    in_doubt        true if at least MIN_INDEPENDENT looks contradict the estimate
    """

    look: Look
    contradictions: Sequence[float]
    hypotheses: Sequence[LoopHypothesis]
    returned_at: Sequence[float]
    joins: bool
    in_doubt: bool

    def accepted(self, *, ended: bool = False) -> LoopDecision | None:
        """Return a closure on which the evidence of the drive may decide, and that has no equal rival.

        See `criteria.qualifies`; `ended` if the run has. A join of parts of the map must pass all checks.
        """
        for hypothesis in self.hypotheses:
            if hypothesis.support[-1].keyframe != self.look.last:
                continue
            consistent, checks = self._judged(hypothesis, ended=ended)
            rivals = self._rivals(hypothesis)
            qualified = self._qualifies(consistent, checks, ended=ended)
            if qualified and all(prevails(consistent, rival) for rival in rivals):
                return self._decide(consistent, rivals, checks)
        return None

    def decision(self, hypothesis: LoopHypothesis) -> tuple[LoopDecision, int]:
        """Return the decision for a hypothesis, and the number of rivals over which it does not prevail."""
        rivals = self._rivals(hypothesis)
        consistent, checks = self._judged(hypothesis)
        return self._decide(consistent, rivals, checks), sum(not prevails(consistent, rival) for rival in rivals)

    def _rivals(self, hypothesis: LoopHypothesis) -> list[LoopHypothesis]:
        return [other for other in self.hypotheses if other is not hypothesis]

    def _judged(self, hypothesis: LoopHypothesis, *, ended: bool = False) -> tuple[LoopHypothesis, tuple[Check, ...]]:
        """Return a hypothesis with its checks; if it qualifies, with the consistent part of its support only."""
        checks = self._checks(hypothesis)
        if self._qualifies(hypothesis, checks, ended=ended):
            hypothesis = replace(hypothesis, support=self.look.consistent(hypothesis.support))
            checks = self._checks(hypothesis)
        return hypothesis, checks

    def _qualifies(self, hypothesis: LoopHypothesis, checks: Sequence[Check], *, ended: bool) -> bool:
        """Return True if a hypothesis qualifies; no evidence follows for a join, which so must pass all checks."""
        if self.joins:
            return all(check.passed for check in checks)
        return qualifies(hypothesis, checks, in_doubt=self.in_doubt, ended=ended)

    def _checks(self, hypothesis: LoopHypothesis) -> tuple[Check, ...]:
        """Return the checks of a hypothesis; looks that agree with the estimate contradict it too."""
        first = hypothesis.support[0].travelled
        against = max(hypothesis.contradictions_since(first), sum(at >= first for at in self.returned_at))
        return support_checks(hypothesis, self.look, against, joins=self.joins)

    def _decide(
        self, hypothesis: LoopHypothesis, rivals: Sequence[LoopHypothesis], checks: tuple[Check, ...]
    ) -> LoopDecision:
        """Return the decision to close the loop of a hypothesis."""
        count, first = len(hypothesis.support), hypothesis.support[0].travelled
        # Metres driven up to the begin of the submap of the first look that shows that the estimate is wrong.
        wrong_since = min([first, *self.contradictions]) - SUBMAP_LENGTH
        return confirm(
            self.look,
            hypothesis,
            f"{count} submap matches over {hypothesis.span:.0f} m agree",
            rival_support=max((rival.support_since(first) for rival in rivals), default=0),
            contradictions=hypothesis.contradictions_since(first),
            checks=checks,
            since=self.look.first_of_part if self.joins else self.look.keyframe_at(wrong_since),
            joins=self.joins,
        )
