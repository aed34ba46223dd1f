"""The matches of a look: which is the best at a place, and whether one that the estimate admits is recognised."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers import se2
from slam.loop_closure.criteria import MAX_CLOSED_DISTANCE
from slam.loop_closure.submap_search import SubmapMatch
from slam.loop_closure.votes import Vote, best_at_place, is_recognised

NEAR, FAR = np.zeros(3), np.array([3.0, 0.0, 0.0])  # the estimate admits a closure at the first place only


def squared_distance(old: int, relative: se2.Pose) -> float:
    return 0.5 * MAX_CLOSED_DISTANCE if relative[0] == 0.0 else 2.0 * MAX_CLOSED_DISTANCE


def vote_at(pose: se2.Pose, fit: float) -> Vote:
    return Vote(0, SubmapMatch(pose, 1e-3 * np.eye(3), fit, known=0.9), pose)


@pytest.mark.parametrize(
    ("votes", "recognised"),
    [
        ([vote_at(NEAR, 0.7)], True),
        ([vote_at(FAR, 0.95)], False),
        ([vote_at(NEAR, 0.7), vote_at(FAR, 0.95)], False),  # a corridor fits badly all along itself
        ([vote_at(NEAR, 0.94), vote_at(FAR, 0.95)], True),
        ([], False),
    ],
)
def test_a_place_is_recognised_if_no_other_one_fits_clearly_better(votes: list[Vote], recognised: bool) -> None:
    look: Any = SimpleNamespace(squared_distance=squared_distance)
    assert is_recognised(look, votes) == recognised


def test_better_match_at_the_same_place_replaces_that_near_a_hypothesis() -> None:
    """Gauss-Newton may stop at the next door frame; the search has found the right one."""
    look: Any = SimpleNamespace(pose=np.zeros(3))
    near, better = vote_at(np.array([0.4, 0.0, 0.0]), 0.8), vote_at(NEAR, 0.97)
    elsewhere = vote_at(FAR, 0.99)
    assert best_at_place(look, near, [elsewhere, better]) is better
    assert best_at_place(look, better, [elsewhere, near]) is better
