"""Loop search: which candidates are rejected, pending or confirmed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np

from drivers import se2
from slam.geometry.segments import Floats
from slam.loop_closure.decision import LoopDecision
from slam.loop_closure.loop_search import LoopSearch
from slam.loop_closure.loop_status import LoopStatus
from slam.mapping.mapper import Mapper

from .rooms import CERTAIN, ROOM, UNCERTAIN, map_twice

SHORT_DRIFT = np.array([0.4, 0.3, 0.0])
LONG_DRIFT = np.array([1.5, -0.9, 0.1])


def build_mapper(drift: se2.Pose, covariance: Floats, number: int = 0) -> Mapper:
    """Return a stand-in for a mapper with the room mapped twice, and `number` further keyframes two metres apart."""
    landmarks, pose, travelled = map_twice(ROOM, drift)
    mapper = SimpleNamespace(
        landmarks=landmarks,
        pose=pose,
        travelled=[*travelled, travelled[-1] + 2.0 * number],
        recent_segments=[],
        keyframe_count=3,
        relative_covariance=lambda old, keyframe: covariance,
    )
    return cast(Mapper, mapper)


def search_repeatedly(drifts: list[se2.Pose], covariance: Floats) -> list[LoopDecision]:
    """Search in a room mapped twice, every two metres, with the same walls each time; return the decisions."""
    search = LoopSearch()
    decisions = [search.search(build_mapper(drift, covariance, number)) for number, drift in enumerate(drifts)]
    assert None not in decisions
    return [decision for decision in decisions if decision is not None]


def statuses_of(drifts: list[se2.Pose], covariance: Floats) -> list[LoopStatus]:
    return [decision.status for decision in search_repeatedly(drifts, covariance)]


def test_distant_place_is_rejected_if_the_pose_is_certain() -> None:
    (rejected,) = search_repeatedly([LONG_DRIFT], CERTAIN)
    assert rejected.status is LoopStatus.REJECTED
    assert "standard deviations" in rejected.verdict.reason
    assert statuses_of([LONG_DRIFT] * 3, UNCERTAIN) == [LoopStatus.PENDING] * 3


def test_same_walls_confirm_only_a_short_motion_that_drift_does_not_explain() -> None:
    assert statuses_of([SHORT_DRIFT] * 2, CERTAIN) == [LoopStatus.PENDING, LoopStatus.CONFIRMED]
    assert statuses_of([SHORT_DRIFT] * 3, UNCERTAIN) == [LoopStatus.PENDING] * 3


def test_same_walls_do_not_confirm_after_a_disagreement() -> None:
    assert statuses_of([-SHORT_DRIFT, SHORT_DRIFT, SHORT_DRIFT], CERTAIN) == [LoopStatus.PENDING] * 3


def test_retracted_motion_is_rejected_also_after_restoring_the_state() -> None:
    search, restored = LoopSearch(), LoopSearch()
    (decision,) = search_repeatedly([SHORT_DRIFT], CERTAIN)
    search.exclude(decision)
    restored.restore(search.state)
    for some in (search, restored):
        again = some.search(build_mapper(SHORT_DRIFT, CERTAIN))
        assert again is not None
        assert again.status is LoopStatus.REJECTED
        assert again.verdict.reason == "was retracted before"
