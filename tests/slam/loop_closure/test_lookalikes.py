"""No wrong loop closure is accepted in worlds of similar-looking places, nor if false hypotheses are forced."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers import se2
from slam.evaluation.benchmarks import false_closures
from slam.evaluation.benchmarks.false_closures import Adversary
from slam.evaluation.benchmarks.lookalike import WORLDS, LookalikeRun, run_world, run_worlds, summarise_worlds
from slam.evaluation.benchmarks.loop_scoring import ScoredDecision
from slam.loop_closure.loop_status import LoopStatus
from slam.loop_closure.proposal import are_distinct, propose
from slam.loop_closure.recent_walls import select_recent_and_reference
from slam.mapping.landmarks import Landmarks

from ...recordings import recording_folder


def decided(status: str, error: float, turn: float = 0.0, reason: str = "all checks passed") -> ScoredDecision:
    return ScoredDecision(10, status, reason, error, turn)


def build_drive(
    *decisions: ScoredDecision, drift: float = 2.0, joined: bool = True, errors: tuple[float, ...] = ()
) -> LookalikeRun:
    return LookalikeRun("here", 0, decisions, drift, joined, doubled=0, ate=0.1, relocalisation_errors=errors)


def test_only_accepted_closures_count_as_wrong() -> None:
    assert not build_drive(
        decided(LoopStatus.PENDING, 3.0), decided(LoopStatus.REJECTED, 3.0), decided(LoopStatus.ACCEPTED, 0.2)
    ).wrong
    assert build_drive(decided(LoopStatus.ACCEPTED, 0.6)).wrong
    assert build_drive(decided(LoopStatus.ACCEPTED, 0.1, np.radians(11.0))).wrong


def test_row_counts_needed_and_found_closures() -> None:
    closed, missed = (
        build_drive(decided(LoopStatus.ACCEPTED, 0.1)),
        build_drive(decided(LoopStatus.REJECTED, 2.0, reason="7.1 m of wall < 8 m"), joined=False),
    )
    unneeded = build_drive(decided(LoopStatus.REJECTED, 0.0, reason="6.4 m of wall < 8 m"), drift=0.1)
    (row,) = summarise_worlds([closed, missed, unneeded])
    assert (row.drives, row.needed, row.found) == (3, 2, 1)
    assert (row.proposed, row.accepted, row.rejected, row.pending, row.wrong) == (3, 1, 2, 0, 0)
    assert row.reasons == {"m of wall m": 2}


def test_row_counts_wrong_relocalisations_and_drives_with_wrong_final_pose() -> None:
    twice, once = build_drive(errors=(0.02, 18.7)), replace(build_drive(errors=(0.4,)), last_error=1.2)
    (row,) = summarise_worlds([twice, once, build_drive()])
    assert (row.relocated, row.misplaced, row.ended_off) == (3, 1, 1)
    assert (twice.misplaced, once.misplaced) == (1, 0)


def test_needed_loop_is_closed_at_the_right_place() -> None:
    result = run_world("large_loop", 0)
    assert result.needed
    assert result.joined
    assert result.accepted
    assert not result.wrong


@pytest.mark.parametrize(("world", "seed"), [("moved_furniture", 16), ("equal_offices", 18)])
def test_no_wrong_closure_is_accepted_between_similar_places(world: str, seed: int) -> None:
    result = run_world(world, seed)
    convincing = [
        d for d in result.decisions if d.error > 0.5 and (d.status == LoopStatus.PENDING or "deviations" in d.reason)
    ]
    assert convincing, "no wrong candidate passed the checks: the test proves nothing"
    assert not result.wrong


@pytest.mark.parametrize("seed", [1, 2])
def test_robot_is_not_relocalised_at_similar_place_unless_kidnapped(seed: int) -> None:
    """The robot leaves a court too wide to see across by a corridor that looks like the one it came from."""
    result = run_world("symmetric_room", seed)
    assert result.misplaced == 0
    assert not result.wrong
    assert result.last_error < 4.0  # drift


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_no_wrong_closure_is_accepted_in_any_world() -> None:
    drives = list(run_worlds(processes=2))
    rows = {row.world: row for row in summarise_worlds(drives)}
    assert [(d.world, d.seed, d.wrong) for d in drives if d.wrong] == []
    assert [(d.world, d.seed, d.relocalisation_errors) for d in drives if d.misplaced] == []
    assert [(d.world, d.seed, d.failed) for d in drives if d.failed] == []
    assert set(rows) == set(WORLDS)
    assert rows["large_loop"].needed >= 10
    assert rows["large_loop"].found >= 0.8 * rows["large_loop"].needed
    assert sum(row.needed > 0 for row in rows.values()) >= 6


def test_benchmark_prints_one_row_per_world(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes = {
        0: build_drive(decided(LoopStatus.ACCEPTED, 0.1)),
        1: replace(build_drive(decided(LoopStatus.ACCEPTED, 3.0)), seed=1),
    }
    monkeypatch.setattr("slam.warmup.warm_up", lambda: None)
    monkeypatch.setattr(
        "slam.evaluation.benchmarks.lookalike.run_world", lambda world, seed: replace(outcomes[seed], world=world)
    )
    options = ("bench", "lookalike", "--worlds", "square,large_loop", "--processes", "1")
    result = wclm(*options, "--seeds", "1", "--json")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["seeds"] == 1
    assert "wclm-slam" in content["versions"]
    assert [(row["world"], row["found"], row["wrong"]) for row in content["worlds"]] == [
        ("square", 1, 0),
        ("large_loop", 1, 0),
    ]
    result = wclm(*options, "--seeds", "2")
    assert result.exit_code == 1
    assert "wrong loop closures in square seed 1, large_loop seed 1" in result.stderr
    outcomes[1] = replace(build_drive(errors=(18.7,)), seed=1)
    result = wclm(*options, "--seeds", "2")
    assert result.exit_code == 1
    assert "wrong relocalisations in square seed 1, large_loop seed 1" in result.stderr
    assert wclm("bench", "lookalike", "--worlds", "moon").exit_code == 2


# False hypotheses


def two_rooms() -> tuple[Landmarks, np.ndarray[Any, Any]]:
    """Return a room mapped twice, the second time half a metre off, and the robot's pose."""
    room = np.array(
        [[3.0, 0.0, 0.0], [6.0, 2.0, np.pi / 2], [3.0, 4.0, np.pi], [0.0, 2.0, -np.pi / 2], [2.0, 2.5, 0.3]]
    )
    landmarks = Landmarks()
    for keyframe, moved in enumerate([np.zeros(3), np.array([0.5, 0.3, 0.05])]):
        for frame in room:
            wall = landmarks.add_wall(se2.compose(moved, frame), 1.5, keyframe)
            landmarks.walls.rows["in_graph"][wall] = True
            landmarks.walls.rows["observations"][wall] = 2
    return landmarks, np.array([3.0, 2.0, 0.0])


def test_adversary_proposes_wrong_places_and_forges_every_other_score() -> None:
    landmarks, pose = two_rooms()
    recent, old = select_recent_and_reference(landmarks, pose, np.array([0.0, 80.0]))
    honest = propose(recent, old, pose)
    adversary = Adversary(at=frozenset({1, 2}))
    assert len(adversary(recent, old, pose)) == len(honest)
    adversary(recent, old, pose)
    forged = adversary(recent, old, pose)[1]
    assert len(adversary.injected) == 2
    assert forged.overlap_ratio == 1.0
    assert forged.length > max(hypothesis.length for hypothesis in honest)
    assert all(are_distinct(forged.motion, other.motion, pose) for other in honest[:2])


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", ["intel", "fr079", "csail"])
def test_false_hypotheses_do_not_change_the_accuracy(name: str) -> None:
    folder = recording_folder(name, "clf", "relations")
    outcome = false_closures.run_with_false_hypotheses(folder / f"{name}.clf", folder / f"{name}.relations")
    assert outcome.injected == min(50, outcome.searches)
    assert outcome.false_accepted == 0
    assert outcome.translation <= 1.1 * outcome.translation_clean
    assert outcome.rotation <= 1.1 * outcome.rotation_clean
