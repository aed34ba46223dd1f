"""Evidence for loops: to another place, and beyond the uncertainty of an estimate whose covariances are too small."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from slam.evaluation.benchmarks.lookalike import MAX_ERROR, run_world
from slam.loop_closure.decision import LoopDecision, LoopMatch
from slam.loop_closure.loop_status import LoopStatus
from slam.mapping.keyframe_covariances import KeyframeCovariances
from slam.recognition import loop_evidence
from slam.recognition.location import DOUBTED, RECOGNISED, Expectation, Location

from ..simulated_worlds import limit_drives
from .test_drive_scans import mapped

COVARIANCE_FACTOR = 0.02  # standard deviations seven times too small


@pytest.fixture
def expectations(monkeypatch: pytest.MonkeyPatch) -> list[Expectation]:
    """Return a list that contains, after a run, what was known before at each check of evidence."""
    found: list[Expectation] = []

    def locate(drive: Any, known: Any, expected: Expectation, *others: Any) -> Location:
        found.append(expected)
        return original(drive, known, expected, *others)

    original = loop_evidence.locate
    monkeypatch.setattr(loop_evidence, "locate", locate)
    return found


@pytest.mark.slow
def test_a_loop_beyond_the_uncertainty_needs_evidence_by_which_the_covariance_is_wrong(
    monkeypatch: pytest.MonkeyPatch, expectations: list[Expectation]
) -> None:
    """The estimate is in doubt: looks contradict it, and recognise no place that its uncertainty admits.

    The drive is not compared with the last third of the map, which has drifted with it.
    """
    known: list[NDArray[np.bool_]] = []

    def scan(mapper: Any, local_field: Any, chosen: NDArray[np.bool_]) -> Any:
        known.append(chosen)
        return original(mapper, local_field, chosen)

    original = loop_evidence.scan_keyframes
    monkeypatch.setattr(loop_evidence, "scan_keyframes", scan)
    for name in ("relative", "relative_bound", "relative_to_all"):
        monkeypatch.setattr(KeyframeCovariances, name, _scaled(getattr(KeyframeCovariances, name)))
    limit_drives(monkeypatch, 130.0, rate=3.0)  # the loop is closed before
    run = run_world("large_loop", 46)
    assert run.needed
    assert run.joined
    assert [decision.status for decision in run.decisions] == [LoopStatus.ACCEPTED]
    assert run.decisions[0].error < MAX_ERROR
    assert set(expectations) == {DOUBTED}
    assert all(chosen.any() and not chosen[len(chosen) * 2 // 3 :].any() for chosen in known)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8713, 8717, 9029])
def test_furniture_that_was_moved_together_does_not_close_a_loop(seed: int, expectations: list[Expectation]) -> None:
    """Two thirds of what the lidar sees in the room fit a metre beside the right place, but not the long walls."""
    run = run_world("moved_furniture", seed, "half-circle")
    assert any("the drive as a whole" in decision.reason for decision in run.decisions)
    assert RECOGNISED in expectations
    assert not run.wrong
    assert run.last_error < 0.3


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "variant"), [(9224, "standard"), (9027, "half-circle")])
def test_a_loop_is_closed_where_the_drive_as_a_whole_fits(seed: int, variant: str) -> None:
    """Four looks agree a metre beside the right place, where the furniture is now."""
    run = run_world("moved_furniture", seed, variant)
    assert run.joined
    (closure,) = run.accepted
    assert "fit in one place only, at another place than the looks that agree" in closure.reason
    assert closure.error < 0.05


@pytest.mark.slow
def test_a_loop_is_not_closed_where_the_drive_fits_if_places_of_the_map_look_as_much_alike(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(loop_evidence.SelfSimilarity, "of", lambda self, drive: 50.0)
    run = run_world("moved_furniture", 9224)
    assert not run.accepted
    assert any("fits at another place than" in decision.reason for decision in run.decisions)


@pytest.mark.slow
@pytest.mark.parametrize("similarity", [None, 200.0])
def test_at_the_end_the_evidence_must_outweigh_the_similarity_if_the_robot_was_not_far_enough_away(
    monkeypatch: pytest.MonkeyPatch, similarity: float | None
) -> None:
    """The robot ends within 10 m, and its position may be wrong by more."""
    if similarity is not None:
        monkeypatch.setattr(loop_evidence.SelfSimilarity, "of", lambda self, drive: similarity)
    run = run_world("mirrored_wing", 9233)
    assert run.needed
    assert run.joined == (similarity is None)
    assert not run.wrong


@pytest.mark.slow
def test_less_must_be_mapped_near_the_estimate() -> None:
    """A lidar that sees half a circle shows other surfaces than before, but no equal place is near."""
    run = run_world("symmetric_room", 8918, "half-circle")
    assert run.unambiguous
    assert run.joined
    assert not run.wrong


@pytest.mark.slow
def test_an_office_that_is_not_mapped_is_not_taken_for_an_equal_one() -> None:
    """The robot looks into the next of several equal offices, four metres beside one that it has mapped.

    The right place may be an equal one that is not mapped yet, as that of a lost robot, see test_drive_scans.
    """
    run = run_world("equal_offices", 9012, "half-circle")
    assert run.needed
    assert not run.wrong


def test_a_loop_is_rejected_if_no_earlier_pass_is_left_to_compare_the_drive_with() -> None:
    state, _ = mapped("office", 1, 0.0, 12.0)
    mapper, nothing = state.mapper, np.zeros(3)
    last, old = mapper.keyframe_count - 1, np.zeros(mapper.keyframe_count, dtype=bool)
    match = LoopMatch(last, 0, nothing, 1e-4 * np.eye(3), mapper.travelled[last], 1.0, 1.0)
    points = np.zeros((0, 2))
    decision = LoopDecision(
        1, last, 0, nothing, nothing, LoopStatus.CONFIRMED, "", (match,), 0.0, 0.0, (), last, (points, points)
    )
    checked = loop_evidence.check_evidence(mapper, state.local_field, decision, old)
    assert checked.status is LoopStatus.REJECTED
    assert "belong to the drive" in checked.reason


def _scaled(function: Any) -> Any:
    """Return a method whose covariances are COVARIANCE_FACTOR times those of another one."""

    def scaled(self: KeyframeCovariances, *arguments: Any, **options: Any) -> Any:
        result = function(self, *arguments, **options)
        if isinstance(result, np.ndarray):
            return COVARIANCE_FACTOR * result
        return [COVARIANCE_FACTOR * covariance for covariance in result]

    return scaled
