"""Decisions against hypotheses of loop closure, in words for reports."""

from __future__ import annotations

from dataclasses import replace

from ..geometry.significance import SUPPORT_RATIO
from .decision import Check, LoopDecision
from .loop_status import LoopStatus

# Least number of looks that support a hypothesis to be reported. Origin: definition, a single one agrees with none.
MIN_REPORTED_SUPPORT = 2
SENTENCES = {
    "support": "{:.0f} looks agree (requires {:.0f})",
    "span": "the looks that agree extend over {:.1f} m of driving (requires {:.1f} m)",
    "extent": "the positions that the looks show are up to {:.1f} m apart (requires {:.1f} m)",
    "contradicted": "{:.0f} % as many looks contradict it as support it (at most {:.0f} %)",
    "mahalanobis": "the robot would move by {:.1f} standard deviations of the estimate (at most {:.1f})",
    "rival": "another place has {:.0f} % as many looks that support it (at most {:.0f} %)",
    "last-look": "the last look fits {:.0f} places as well (at most {:.0f})",
    "retracted": "later scans have contradicted this correction before",
}
"""Failed check as a sentence about its value and its gate."""
# Checks whose value and gate are stated in per cent. Origin: definition.
SHARES = ("contradicted", "rival")


def rejected(decision: LoopDecision, equal: int, was_retracted: bool) -> LoopDecision:
    """Return a decision as rejected, with the failed checks in words, the worst first.

    equal          number of rivals over which the hypothesis does not prevail; one of them may be the estimate
    was_retracted  true if a closure by the same motion was retracted
    """
    checks, largest_rival = list(decision.checks), 1.0 / SUPPORT_RATIO
    if equal and decision.runner_up > largest_rival:
        checks.append(Check("rival", decision.runner_up, largest_rival, at_least=False))
    elif equal:
        checks.append(Check("last-look", 1.0 + equal, 1.0, at_least=False))
    if was_retracted:
        checks.append(Check("retracted", 1.0, 0.0, at_least=False))
    failed = sorted((check for check in checks if not check.passed), key=lambda check: check.margin)
    reason = "; ".join(_sentence(check) for check in failed)
    return replace(decision, status=LoopStatus.REJECTED, reason=reason, checks=tuple(checks))


def _sentence(check: Check) -> str:
    """Return a failed check in words."""
    scale = 100.0 if check.name in SHARES else 1.0
    return SENTENCES[check.name].format(scale * check.value, scale * check.gate)
