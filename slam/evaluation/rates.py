"""Confidence limits of rates that are estimated from counts."""

from __future__ import annotations

from scipy.special import betaincinv

CONFIDENCE = 0.95
"""Probability with which a rate is at most its upper limit."""


def upper_limit(count: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """Return the one-sided upper confidence limit of a rate, for `count` events in `trials` independent trials.

    The exact limit of Clopper and Pearson (Biometrika 26, 1934): the largest rate with which `count` events or fewer
    have a probability of 1 - `confidence`. It is 1 without trials. Raises ValueError if `count` is not within
    0 to `trials`.
    """
    if not 0 <= count <= trials:
        raise ValueError(f"{count} events in {trials} trials")
    return 1.0 if count == trials else float(betaincinv(count + 1, trials - count, confidence))
