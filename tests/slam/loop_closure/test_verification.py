"""Proposal and verification of loop closure hypotheses: which motions are found, and which are rejected and why."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import Floats, Segments
from slam.loop_closure.proposal import Hypothesis, propose, refine_hypothesis
from slam.loop_closure.recent_walls import REFERENCE_DISTANCE, select_recent_and_reference
from slam.loop_closure.verification import Verdict, VerificationContext, check_against_estimate, exceeds_drift, verify
from slam.mapping.landmarks import Landmarks

from .rooms import INSIDE, ROOM, UNCERTAIN, add_walls, map_twice, views_from


def hypotheses_of(landmarks: Landmarks, pose: se2.Pose, travelled: Floats) -> list[Hypothesis]:
    recent, reference = select_recent_and_reference(landmarks, pose, travelled)
    return propose(recent, reference, pose)


def verify_best(
    landmarks: Landmarks,
    pose: se2.Pose,
    travelled: Floats,
    views: list[tuple[se2.Pose, Segments]],
    covariance: Floats,
) -> Verdict:
    """Return the verdict on the best hypothesis, with the `covariance` of the robot's pose."""
    recent, reference = select_recent_and_reference(landmarks, pose, travelled)
    context = VerificationContext(recent, reference, landmarks, pose, views, lambda: covariance)
    return verify(propose(recent, reference, pose), context)


@pytest.mark.parametrize("drift", [[0.9, -0.7, 0.12], [-1.5, 0.4, -0.1], [0.3, 0.25, 0.0]])
def test_drift_of_room_mapped_twice_is_found(drift: list[float]) -> None:
    landmarks, pose, travelled = map_twice(ROOM, np.array(drift))
    null, best, *_ = hypotheses_of(landmarks, pose, travelled)
    assert null.overlap_ratio < 0.6 * best.overlap_ratio
    assert best.overlap_ratio == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(se2.compose(best.motion, pose), INSIDE, atol=5e-3)
    assert sorted(best.matches) == list(range(len(ROOM)))


def test_room_mapped_twice_passes_all_checks() -> None:
    drift = np.array([0.9, -0.7, 0.12])
    landmarks, pose, travelled = map_twice(ROOM, drift)
    moved = np.column_stack([se2.compose(drift, ROOM[:, :3]), ROOM[:, 3]])
    verdict = verify_best(landmarks, pose, travelled, views_from(pose, moved), UNCERTAIN)
    assert verdict.accepted, verdict.reason
    assert verdict.contradicted == 0.0


def test_gate_of_estimate_depends_on_direction_of_motion() -> None:
    along_a_corridor = np.diag([2.0, 0.05, 0.01]) ** 2
    assert check_against_estimate(np.array([4.0, 0.0, 0.0]), along_a_corridor).passed
    assert not check_against_estimate(np.array([0.0, 4.0, 0.0]), along_a_corridor).passed
    assert not exceeds_drift(np.array([0.5, 0.0, 0.0]), along_a_corridor)
    assert exceeds_drift(np.array([0.0, 0.5, 0.0]), along_a_corridor)
    assert check_against_estimate(np.array([0.0, 0.5, 0.0]), along_a_corridor).passed  # misassociated walls explain it


def test_motions_beyond_expected_drift_are_not_proposed() -> None:
    landmarks, pose, travelled = map_twice(ROOM, np.array([3.0, 0.0, 0.0]), distance=REFERENCE_DISTANCE + 1.0)
    for hypothesis in hypotheses_of(landmarks, pose, travelled):
        assert np.hypot(*(se2.compose(hypothesis.motion, pose) - pose)[:2]) < 1.5


def test_parallel_walls_alone_propose_only_the_null_hypothesis() -> None:
    corridor = np.array([[x, y, h, 4.0] for x in (-4.0, 4.0, 12.0) for y, h in ((0.0, 0.0), (4.0, np.pi))])
    landmarks, pose, travelled = map_twice(corridor, np.array([0.0, 0.8, 0.0]))
    assert len(hypotheses_of(landmarks, pose, travelled)) == 1


@pytest.mark.parametrize(("sigma", "accepted"), [(2.0, False), (0.1, True)])
def test_equal_doors_are_ambiguous_unless_estimate_excludes_the_others(sigma: float, accepted: bool) -> None:
    jambs = [[x, y, np.pi / 2, 0.3] for x in np.arange(0.0, 20.0, 2.0) for y in (0.0, 2.0)]
    corridor = np.array([*jambs, [10.0, -0.3, 0.0, 10.0], [10.0, 2.3, np.pi, 10.0]])
    landmarks, pose, travelled = map_twice(corridor, np.array([0.3, 0.1, 0.0]), distance=100.0)
    verdict = verify_best(landmarks, pose, travelled, [], np.diag([sigma, sigma, 0.02]) ** 2)
    assert (verdict.accepted, verdict.ambiguous) == (accepted, not accepted), verdict.reason
    assert accepted or "alternative" in verdict.reason


def test_directional_ratio_is_low_if_walls_match_along_one_direction_only() -> None:
    """The sides of the room match, the walls across do not: furniture was moved, or it is another room as wide."""
    drift = np.array([0.9, -0.7, 0.0])
    sides = np.array([[x, y, heading, 3.0] for x in (3.0, 9.0) for y, heading in ((0.0, 0.0), (4.0, np.pi))])
    across = np.array([[x, 2.0, np.pi / 2, 0.9] for x in (0.5, 2.5, 4.5, 6.5)])
    landmarks = Landmarks()
    add_walls(landmarks, np.concatenate([sides, across]), 0)
    moved = across.copy()
    moved[1:, 0] += 0.8
    add_walls(landmarks, np.concatenate([sides, moved]), 1, drift)
    pose = se2.compose(drift, INSIDE)
    recent, reference = select_recent_and_reference(landmarks, pose, np.array([0.0, 60.0]))
    found = refine_hypothesis(np.array([-0.9, 0.7, 0.0]), recent, reference, pose)
    assert found.overlap_ratio > 0.65
    assert found.min_directional_ratio == pytest.approx(0.25, abs=0.05)


def test_segments_behind_reference_walls_contradict_hypothesis() -> None:
    landmarks, pose, travelled = map_twice(ROOM, np.array([0.9, -0.7, 0.12]))
    add_walls(landmarks, np.array([[4.0, 2.0, np.pi / 2, 1.8]]), 0)  # a partition in the first pass only
    moved = np.column_stack([se2.compose(np.array([0.9, -0.7, 0.12]), ROOM[:, :3]), ROOM[:, 3]])
    verdict = verify_best(landmarks, pose, travelled, views_from(pose, moved[1:2]), UNCERTAIN)
    assert verdict.contradicted > 0.3


def test_door_between_two_observations_of_a_wall_hides_nothing() -> None:
    landmarks = Landmarks()
    left, right = np.array([1.0, 0.0, 0.0, 1.0]), np.array([4.0, 0.0, 0.0, 1.0])
    wall = landmarks.add_wall(left[:3], 1.0, 0)
    landmarks.observe_wall(wall, right[:3], 1.0, 0)
    assert landmarks.is_covered(wall, 0.5)
    assert landmarks.is_covered(wall, 3.0)
    assert not landmarks.is_covered(wall, 1.5)
