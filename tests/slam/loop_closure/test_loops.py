"""Loop closure: what is proposed, what is refused and why, and what closing does to the map."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.loop_closure.closer import LoopCloser, LoopDecision, close
from slam.loop_closure.proposal import Hypothesis, propose, refined
from slam.loop_closure.recent_walls import OLD_WAY, recent_and_reference
from slam.loop_closure.verification import Verdict, VerificationContext, allowed_by_estimate, is_astray, verify
from slam.mapping.data_association import UNMATCHED, Association
from slam.mapping.keyframes import Motion
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import empty_local_map
from slam.mapping.mapper import Mapper

# A room with unequal sides and a niche: walls as frames with x along them, seen from the room, and half their lengths.
ROOM = np.array(
    [
        [3.0, 0.0, 0.0, 3.0],
        [6.0, 2.0, np.pi / 2, 2.0],
        [4.5, 4.0, np.pi, 1.5],
        [3.0, 4.75, np.pi / 2, 0.75],
        [1.5, 5.5, np.pi, 1.5],
        [0.0, 2.75, -np.pi / 2, 2.75],
    ]
)
INSIDE = np.array([2.0, 2.0, 0.3])
KNOWN, UNKNOWN = np.diag([0.02, 0.02, 0.01]) ** 2, np.diag([2.0, 2.0, 0.2]) ** 2  # of where the robot is


def add(landmarks: Landmarks, walls: Floats, keyframe: int, moved: se2.Pose | None = None) -> list[int]:
    """Walls (n, 4) seen twice from a keyframe, moved as a whole; their identities."""
    identities = []
    for wall in walls:
        frame = wall[:3] if moved is None else se2.compose(moved, wall[:3])
        identity = landmarks.add_wall(frame, wall[3], keyframe)
        landmarks.walls.rows["in_graph"][identity] = True
        landmarks.walls.rows["observations"][identity] = 2
        identities.append(identity)
    return identities


def seen_again(walls: Floats, drift: se2.Pose, way: float = 60.0) -> tuple[Landmarks, se2.Pose, Floats]:
    """Walls mapped at first, and once more after `way` metres when everything seen is off by `drift`."""
    landmarks = Landmarks()
    add(landmarks, walls, 0)
    add(landmarks, walls, 1, drift)
    return landmarks, se2.compose(drift, INSIDE), np.array([0.0, way])


def hypotheses_of(landmarks: Landmarks, pose: se2.Pose, ways: Floats) -> list[Hypothesis]:
    recent, old = recent_and_reference(landmarks, pose, ways)
    return propose(recent, old, pose)


def views_from(pose: se2.Pose, walls: Floats) -> list[tuple[se2.Pose, Segments]]:
    """All walls, as seen from one place."""
    frames = se2.between(pose, walls[:, :3])
    return [(pose, Segments(frames, walls[:, 3], np.tile(np.eye(2) * 1e-4, (len(walls), 1, 1))))]


def judged(
    landmarks: Landmarks,
    pose: se2.Pose,
    ways: Floats,
    views: list[tuple[se2.Pose, Segments]],
    covariance: Floats,
) -> Verdict:
    """The verdict on the best place, where the estimate has the `covariance` of the pose."""
    recent, old = recent_and_reference(landmarks, pose, ways)
    return verify(
        propose(recent, old, pose), VerificationContext(recent, old, landmarks, pose, views, lambda: covariance)
    )


@pytest.mark.parametrize("drift", [[0.9, -0.7, 0.12], [-1.5, 0.4, -0.1], [0.3, 0.25, 0.0]])
def test_the_drift_of_a_room_seen_again_is_found(drift: list[float]) -> None:
    landmarks, pose, ways = seen_again(ROOM, np.array(drift))
    stay, best, *_ = hypotheses_of(landmarks, pose, ways)
    assert stay.overlap_ratio < 0.6 * best.overlap_ratio
    assert best.overlap_ratio == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(se2.compose(best.motion, pose), INSIDE, atol=5e-3)
    assert sorted(best.matches) == list(range(len(ROOM)))


def test_a_room_seen_again_passes_all_tests() -> None:
    drift = np.array([0.9, -0.7, 0.12])
    landmarks, pose, ways = seen_again(ROOM, drift)
    moved = np.column_stack([se2.compose(drift, ROOM[:, :3]), ROOM[:, 3]])
    verdict = judged(landmarks, pose, ways, views_from(pose, moved), UNKNOWN)
    assert verdict.accepted, verdict.reason
    assert verdict.contradicted == 0.0


DRIFTED_LITTLE, DRIFTED_FAR = np.array([0.4, 0.3, 0.0]), np.array([1.5, -0.9, 0.1])


def looks(drifts: list[se2.Pose], covariance: Floats) -> list[LoopDecision]:
    """What becomes of looks at a room seen again, two metres of driving apart, all at the same walls."""
    closer, decisions = LoopCloser(), []
    for look, drift in enumerate(drifts):
        landmarks, pose, ways = seen_again(ROOM, drift)
        mapper = SimpleNamespace(
            landmarks=landmarks,
            pose=pose,
            travelled=[*ways, ways[-1] + 2.0 * look],
            views=[],
            keyframe_count=3,
            relative_covariance=lambda old, keyframe: covariance,
        )
        decisions.append(closer.search(cast(Mapper, mapper)))
    assert None not in decisions
    return [decision for decision in decisions if decision is not None]


def test_far_places_are_refused_to_a_robot_that_knows_where_it_is() -> None:
    (refused,) = looks([DRIFTED_FAR], KNOWN)
    assert refused.status == "rejected"
    assert "standard deviations" in refused.verdict.reason
    assert [decision.status for decision in looks([DRIFTED_FAR] * 3, UNKNOWN)] == ["held"] * 3


def test_the_same_walls_are_asked_twice_only_where_drift_does_not_explain_a_short_motion() -> None:
    assert [decision.status for decision in looks([DRIFTED_LITTLE] * 2, KNOWN)] == ["held", "agreed"]
    assert [decision.status for decision in looks([DRIFTED_LITTLE] * 3, UNKNOWN)] == ["held"] * 3


def test_after_looks_that_disagree_the_same_walls_do_not_decide() -> None:
    contested = [-DRIFTED_LITTLE, DRIFTED_LITTLE, DRIFTED_LITTLE]
    assert [decision.status for decision in looks(contested, KNOWN)] == ["held"] * 3


def test_how_unexpected_a_motion_is_depends_on_its_direction() -> None:
    along_a_corridor = np.diag([2.0, 0.05, 0.01]) ** 2
    assert allowed_by_estimate(np.array([4.0, 0.0, 0.0]), along_a_corridor).passed
    assert not allowed_by_estimate(np.array([0.0, 4.0, 0.0]), along_a_corridor).passed
    assert not is_astray(np.array([0.5, 0.0, 0.0]), along_a_corridor)
    assert is_astray(np.array([0.0, 0.5, 0.0]), along_a_corridor)
    assert allowed_by_estimate(np.array([0.0, 0.5, 0.0]), along_a_corridor).passed  # walls taken for others explain it


def test_drift_beyond_what_was_driven_is_not_considered() -> None:
    landmarks, pose, ways = seen_again(ROOM, np.array([3.0, 0.0, 0.0]), way=OLD_WAY + 1.0)
    for hypothesis in hypotheses_of(landmarks, pose, ways):
        assert np.hypot(*(se2.compose(hypothesis.motion, pose) - pose)[:2]) < 1.5


def test_parallel_walls_alone_never_close_a_loop() -> None:
    corridor = np.array([[x, y, h, 4.0] for x in (-4.0, 4.0, 12.0) for y, h in ((0.0, 0.0), (4.0, np.pi))])
    landmarks, pose, ways = seen_again(corridor, np.array([0.0, 0.8, 0.0]))
    assert len(hypotheses_of(landmarks, pose, ways)) == 1  # to stay


@pytest.mark.parametrize(("sigma", "accepted"), [(2.0, False), (0.1, True)])
def test_a_corridor_with_equal_doors_is_ambiguous_unless_the_estimate_rules_the_others_out(
    sigma: float, accepted: bool
) -> None:
    jambs = [[x, y, np.pi / 2, 0.3] for x in np.arange(0.0, 20.0, 2.0) for y in (0.0, 2.0)]
    corridor = np.array([*jambs, [10.0, -0.3, 0.0, 10.0], [10.0, 2.3, np.pi, 10.0]])
    landmarks, pose, ways = seen_again(corridor, np.array([0.3, 0.1, 0.0]), way=100.0)
    verdict = judged(landmarks, pose, ways, [], np.diag([sigma, sigma, 0.02]) ** 2)
    assert (verdict.accepted, verdict.ambiguous) == (accepted, not accepted), verdict.reason
    assert accepted or "another place" in verdict.reason


def test_walls_along_one_direction_alone_do_not_make_a_place() -> None:
    """All along the room agrees, and next to nothing across: the furniture was moved, or it is another room as wide."""
    drift = np.array([0.9, -0.7, 0.0])
    sides = np.array([[x, y, heading, 3.0] for x in (3.0, 9.0) for y, heading in ((0.0, 0.0), (4.0, np.pi))])
    across = np.array([[x, 2.0, np.pi / 2, 0.9] for x in (0.5, 2.5, 4.5, 6.5)])
    landmarks = Landmarks()
    add(landmarks, np.concatenate([sides, across]), 0)
    moved = across.copy()
    moved[1:, 0] += 0.8
    add(landmarks, np.concatenate([sides, moved]), 1, drift)
    recent, old = recent_and_reference(landmarks, se2.compose(drift, INSIDE), np.array([0.0, 60.0]))
    found = refined(np.array([-0.9, 0.7, 0.0]), recent, old, se2.compose(drift, INSIDE))
    assert found.overlap_ratio > 0.65
    assert found.weakest == pytest.approx(0.25, abs=0.05)


def test_walls_that_would_have_hidden_what_was_seen_speak_against_a_place() -> None:
    landmarks, pose, ways = seen_again(ROOM, np.array([0.9, -0.7, 0.12]))
    add(landmarks, np.array([[4.0, 2.0, np.pi / 2, 1.8]]), 0)  # the old room had a partition where now the view is free
    moved = np.column_stack([se2.compose(np.array([0.9, -0.7, 0.12]), ROOM[:, :3]), ROOM[:, 3]])
    verdict = judged(landmarks, pose, ways, views_from(pose, moved[1:2]), UNKNOWN)
    assert verdict.contradicted > 0.3


def test_seen_through_a_door_is_no_contradiction() -> None:
    landmarks = Landmarks()
    left, right = np.array([1.0, 0.0, 0.0, 1.0]), np.array([4.0, 0.0, 0.0, 1.0])
    wall = landmarks.add_wall(left[:3], 1.0, 0)
    landmarks.see_wall(wall, right[:3], 1.0, 0)
    assert landmarks.is_covered(wall, 0.5)
    assert landmarks.is_covered(wall, 3.0)
    assert not landmarks.is_covered(wall, 1.5)


def observe(mapper: Mapper, pose: se2.Pose, motion: se2.Pose, walls: Floats, known: list[int] | None) -> list[int]:
    """A keyframe that sees all walls, as new ones or as the known ones; returns their identities."""
    frames = se2.between(pose, walls[:, :3])
    segments = Segments(frames, walls[:, 3], np.tile(np.diag([0.01, 0.01]) ** 2, (len(walls), 1, 1)))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
    rows = np.full(len(walls), UNMATCHED) if known is None else np.arange(len(walls))
    local = empty_local_map()
    if known is not None:
        local = type(local)(**{**{name: getattr(local, name) for name in local.__slots__}, "walls": np.array(known)})
    none = np.zeros(0)
    nobody = np.zeros(0, dtype=int)
    association = Association(rows, np.zeros(len(walls)), rows, nobody, none, nobody)
    covariance = np.diag([0.05, 0.05, 0.03]) ** 2
    first = mapper.keyframe_count == 0
    step = None if first else Motion(mapper.keyframe_count - 1, motion, covariance)
    view = mapper.add_keyframe(pose, step, segments, corners, association, local)
    mapper.refresh(view)
    return [int(wall) for wall in view.walls]


def drifted_mapper(drift: se2.Pose) -> tuple[Mapper, list[int], list[int]]:
    """A map with the room in it twice: seen at first, and after a tour whose odometry was off by `drift` in all."""
    mapper = Mapper()
    first = observe(mapper, INSIDE, np.zeros(3), ROOM, None)
    step = np.array([0.05, 0.0, 0.0])
    pose = se2.compose(INSIDE, step)
    observe(mapper, pose, step, ROOM, first)
    none = ROOM[:0]
    for _ in range(8):  # out of sight of everything
        motion = se2.between(pose, se2.compose(pose, np.array([drift[0] / 8, drift[1] / 8, drift[2] / 8])))
        pose = se2.compose(pose, motion)
        observe(mapper, pose, motion, none, None)
    there = se2.between(se2.compose(INSIDE, step), pose)
    moved = np.column_stack(
        [se2.compose(se2.compose(pose, se2.inverse(se2.compose(INSIDE, step))), ROOM[:, :3]), ROOM[:, 3]]
    )
    second = observe(mapper, pose, np.zeros(3), moved, None)
    observe(mapper, pose, np.zeros(3), moved, second)
    assert np.hypot(*there[:2]) > 0.5
    return mapper, first, second


def decision(motion: se2.Pose, first: list[int], second: list[int]) -> LoopDecision:
    """Two looks agree that what was seen `second` lies on what was seen `first`, if moved."""
    hypothesis = Hypothesis(motion, 1.0, 20.0, 1.0, np.eye(3), np.arange(len(ROOM)))
    verdict = Verdict(True, "all tests passed", 1.0, len(ROOM), 0.0, 0.01, 0.0, True, False, False)
    return LoopDecision(1, 9, 1, np.zeros(3), verdict, "agreed", hypothesis, tuple(zip(first, second, strict=True)))


def test_closing_brings_the_robot_back_and_makes_one_map_of_two() -> None:
    mapper, first, second = drifted_mapper(np.array([1.6, -1.0, 0.2]))
    back = se2.compose(INSIDE, np.array([0.05, 0.0, 0.0]))
    motion = se2.compose(back, se2.inverse(mapper.pose))
    factors = mapper.graph.factor_count
    closed = close(mapper, decision(motion, first, second))
    assert closed.status == "accepted"
    assert len(closed.merged) == len(ROOM)
    np.testing.assert_allclose(mapper.pose, back, atol=0.01)
    kept = mapper.landmarks.walls.rows["merged_into"]
    assert [kept[wall] for wall in second] == first
    assert mapper.graph.factor_count == factors + len(ROOM)  # the ties; what carried the map over is gone


def test_walls_that_do_not_come_together_make_no_loop() -> None:
    mapper, first, second = drifted_mapper(np.array([1.6, -1.0, 0.2]))
    before, factors = mapper.graph.keyframe_poses(mapper.keyframe_count), mapper.graph.factor_count
    wrong = se2.compose(np.array([0.0, 3.0, 0.9]), mapper.pose)
    trial = copy.deepcopy(mapper)
    refused = close(trial, decision(se2.compose(wrong, se2.inverse(mapper.pose)), first, second))
    assert refused.status == "rejected"
    assert not refused.verdict.accepted
    assert refused.merged == ()
    # and what is done to a copy leaves no trace
    np.testing.assert_allclose(mapper.graph.keyframe_poses(mapper.keyframe_count), before, atol=1e-12)
    assert mapper.graph.factor_count == factors
    assert list(mapper.landmarks.walls.rows["merged_into"][second]) == second
