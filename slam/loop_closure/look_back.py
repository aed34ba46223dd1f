"""Earlier looks that support a hypothesis of loop closure, from before a match has proposed it."""

from __future__ import annotations

import numpy as np

from .criteria import MIN_KNOWN, fits
from .decision import LoopMatch
from .look import SEARCH_INTERVAL, Look
from .loop_hypothesis import LoopHypothesis
from .votes import is_good, vote_in_view


def look_back(hypothesis: LoopHypothesis, look: Look, farthest: float) -> None:
    """Extend the support of a hypothesis to the looks before its first one, as far as all of them support it.

    A match that proposes a hypothesis must stand out among all poses within the uncertainty of the estimate, and the
    robot must be near a place where it was before. So a hypothesis is often proposed only some metres after the robot
    has come back. Its motion is known now, so earlier looks can be tested wherever they see an old place. They count
    only if they contradict the estimate. Else the robot may have been at a place that is not mapped and looks alike.

    look      the last one
    farthest  metres of driving before it up to which earlier looks are tested
    """
    while look.travelled - hypothesis.support[0].travelled < farthest:
        match = _match_before(hypothesis.support[0], look)
        if match is None:
            return
        hypothesis.support.insert(0, match)


def _match_before(first: LoopMatch, look: Look) -> LoopMatch | None:
    """Return the match of the look before the `first` one of a hypothesis, if it supports the hypothesis, else None."""
    earlier = look.at_distance(first.travelled - SEARCH_INTERVAL)
    if earlier is None or not earlier.determines_motion_to(first.keyframe):
        return None
    at_estimate = vote_in_view(earlier, np.zeros(3))
    if at_estimate is None or at_estimate.match.known < MIN_KNOWN or fits(at_estimate.match):
        return None
    vote = vote_in_view(earlier, look.motion_of(first))
    return None if vote is None or not is_good(vote) else earlier.loop_match(vote.old, vote.match)
