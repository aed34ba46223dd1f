"""Loop closure by agreement: looks of several places must support a correction, and rivals keep it open."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers import se2
from features.normal_limits import NORMAL_LIMIT
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.local_field import REFERENCE_DISTANCE, LocalField
from slam.loop_closure import look as look_module
from slam.loop_closure import look_back
from slam.loop_closure.agreement import LoopAgreement
from slam.loop_closure.criteria import MIN_INDEPENDENT, MIN_SUPPORT, SPAN, SUPPORT, support_checks
from slam.loop_closure.decision import LoopDecision, LoopMatch
from slam.loop_closure.look import DOUBTED_REACH, Look
from slam.loop_closure.loop_hypothesis import LoopAgreementState, LoopHypothesis
from slam.loop_closure.loop_status import LoopStatus
from slam.loop_closure.relative_uncertainty import UNMODELLED_SIGMAS
from slam.loop_closure.returns import summarise
from slam.loop_closure.submap_search import REVISIT_GAP, SUBMAP_LENGTH, Submap, SubmapMatch
from slam.loop_closure.submaps import Submaps
from slam.loop_closure.votes import Vote, Votes, vote_in_view
from slam.mapping.landmarks import Landmarks
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints

from ..outlines import outline, visible, with_noise

STEP = 0.5  # metres between keyframes
LENGTH = 24.0  # metres of driving between two rooms
# A long room without symmetry.
ROOM = outline([(0, 0), (16, 0), (16, 3), (13, 3), (13, 4.5), (9, 4.5), (9, 3), (5, 3), (5, 5), (3, 5), (3, 3), (0, 3)])
# A longer one, for closures that need more agreement.
HALL = outline(
    [(0, 0), (36, 0), (36, 3), (33, 3), (33, 4), (31, 4), (31, 3), (26, 3), (26, 5), (23, 5), (23, 3.5), (20, 3.5),
     (20, 3), (13, 3), (13, 4.5), (9, 4.5), (9, 3), (5, 3), (5, 5), (3, 5), (3, 3), (0, 3)]
)  # fmt: skip
# As wide as long, and different on all sides.
COURT = outline(
    [
        (0, 0),
        (16, 0),
        (16, 4),
        (14, 4),
        (14, 6),
        (16, 6),
        (16, 12),
        (9, 12),
        (9, 10.5),
        (5, 10.5),
        (5, 12),
        (0, 12),
        (0, 3),
        (1, 3),
        (1, 2),
        (0, 2),
    ]
)
NO_SEGMENTS = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
SIGMAS = np.array([0.5, 0.5, 0.05])  # of the estimate after the loop


@dataclass
class StubMap:
    """What the search needs of a `Mapper`: estimated poses, distances driven and covariances."""

    covariance: Floats
    growth: float = 0.0
    """Share by which the standard deviations grow with each metre that was driven since the first keyframe."""
    keyframe_poses: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    travelled: list[float] = field(default_factory=list)
    landmarks: Landmarks = field(default_factory=Landmarks)
    asked: list[tuple[int, int]] = field(default_factory=list)
    """Keyframes whose relative covariance was asked for."""

    @property
    def keyframe_count(self) -> int:
        return len(self.keyframe_poses)

    @property
    def pose_covariances(self) -> Floats:
        return np.tile(self.covariance, (self.keyframe_count, 1, 1))

    @property
    def covariances(self) -> StubMap:
        return self

    def relative(self, old: int, keyframe: int) -> Floats:
        self.asked.append((old, keyframe))
        return self.covariance

    def relative_to_all(self, old: list[int], keyframe: int) -> list[Floats]:
        return [self.relative_bound(one, keyframe) for one in old]

    def relative_bound(self, old: int, keyframe: int) -> Floats:
        return np.asarray(self.covariance * (1.0 + self.growth * self.travelled[keyframe]) ** 2)


def drive_twice(
    drift: se2.Pose,
    elsewhere: se2.Pose,
    *,
    interrupted: bool = False,
    apart: bool = False,
    until: float = 15.0,
    room: Floats = ROOM,
    begin: float = 1.0,
    end: float = 15.0,
    sigmas: Floats = SIGMAS,
    growth: float = 0.0,
    proposed: bool = False,
) -> tuple[list[LoopDecision], LocalField, LoopAgreement]:
    """Drive through the room, and after LENGTH metres again, with a drift of the estimate.

    The second time the robot is in truth in a copy of the room that is moved by `elsewhere`. If
    `interrupted`, the state is saved and restored every few keyframes. If `apart`, it has lost its pose in between,
    and joins of both parts of the map are searched for. Returns what was accepted, and the search. Loops that only the
    evidence of the drive, which is not asked here, may close count if they are `proposed`.
    """
    agreement, local_field = LoopAgreement(joins=apart), LocalField()
    state = StubMap(np.diag(sigmas**2), growth)
    random, found = np.random.default_rng(0), []
    for lap, moved in enumerate([np.zeros(3), se2.compose(elsewhere, drift)]):
        if apart and lap:
            state.landmarks.parts.begin(state.keyframe_count, measured=True)
        for x in np.arange(1.0 if lap else begin, until if lap else end, STEP):
            inside = np.array([x, 1.5, 0.0])
            points = with_noise(visible(room, inside), random)
            local_field.add(ScanFeatures(NO_SEGMENTS, NO_CORNERS, ScanPoints(points)))
            state.keyframe_poses = np.vstack([state.keyframe_poses, se2.compose(moved, inside)])
            state.travelled.append(x + lap * (LENGTH + end - 1.0))
            local_field.update(state.keyframe_count - 1, state.keyframe_poses, state.travelled)
            among = ~state.landmarks.parts.connected(np.arange(state.keyframe_count)) if apart else None
            accepted = agreement.search(state, local_field, among)  # type: ignore[arg-type]
            if accepted is not None and (proposed or all(check.passed for check in accepted.checks)):
                found.append(accepted)
            if interrupted and state.keyframe_count % 5 == 0:
                saved, agreement = agreement.state, LoopAgreement()
                agreement.restore(saved, local_field)
    return found, local_field, agreement


def test_drift_is_corrected_once_enough_looks_agree() -> None:
    drift = np.array([0.3, 0.9, 0.08])
    found, _, _ = drive_twice(drift, np.zeros(3))
    assert found
    accepted = found[0]
    assert len(accepted.matches) >= MIN_INDEPENDENT
    assert accepted.matches[-1].travelled - accepted.matches[0].travelled >= SUBMAP_LENGTH
    left = se2.compose(accepted.correction, drift)
    assert np.hypot(*left[:2]) < 0.15  # at the origin, which is up to 15 m away
    assert abs(left[2]) < 0.01
    for match in accepted.matches:
        assert abs(match.relative[1]) < 0.1  # both passes are on the same line


def test_drift_that_leads_to_no_other_place_is_corrected_although_the_drive_ends_soon() -> None:
    """The robot drives for 4 m after it has returned, less than the length of a submap."""
    drift = np.array([0.2, 0.3, 0.02])
    found, _, _ = drive_twice(drift, np.zeros(3), until=5.0)
    assert found
    matches = found[0].matches
    assert len(matches) >= MIN_SUPPORT
    assert SUBMAP_LENGTH > matches[-1].travelled - matches[0].travelled >= NORMAL_LIMIT * SIGMAS[0]
    left = se2.compose(found[0].correction, drift)
    assert np.hypot(*left[:2]) < 0.05
    assert abs(left[2]) < 0.01


@pytest.mark.slow
def test_drift_beyond_the_uncertainty_of_the_estimate_is_corrected_if_correlated_errors_explain_it() -> None:
    """The estimate is wrong by 3.5 of its standard deviations, or by more than correlated errors explain."""
    certain, hall = np.array([0.1, 0.1, 0.02]), {"room": HALL, "until": 35.0, "end": 35.0}
    drift = np.array([0.1, 1.1, 0.0])
    accepted = drive_twice(drift, np.zeros(3), sigmas=certain, **hall)[0][0]
    assert np.hypot(*se2.compose(accepted.correction, drift)[:2]) < 0.2  # at the origin, which is up to 35 m away
    (span,) = [check for check in accepted.checks if check.name == "span"]
    assert span.value >= span.gate >= SUBMAP_LENGTH
    assert drive_twice(np.array([0.1, 2.5, 0.0]), np.zeros(3), sigmas=certain, **hall)[0] == []


@pytest.mark.slow
def test_looks_need_not_extend_over_the_uncertainty_that_is_added_after_the_first_one() -> None:
    """By the uncertainty at each look itself, what the looks show would never suffice: both grow with the drive."""
    hall = {"room": HALL, "until": 35.0, "end": 35.0}
    small = np.array([0.05, 0.05, 0.001])
    found, _, _ = drive_twice(np.array([0.3, 0.7, 0.01]), np.zeros(3), sigmas=small, growth=2.6, **hall)
    assert found
    (extent,) = [check for check in found[0].checks if check.name == "extent"]
    first, last = found[0].matches[0], found[0].matches[-1]
    at_first, at_last = (NORMAL_LIMIT * 0.05 * (1.0 + 2.6 * match.travelled) for match in (first, last))
    assert at_first < extent.value < at_last
    assert extent.gate == pytest.approx(at_first, rel=0.1)


def test_looks_before_the_one_that_proposes_a_loop_count_if_they_see_the_place() -> None:
    """The first pass begins at x = 14 m. The second one begins 13 m before that, and ends 1 m after that."""
    drift, begin = np.array([0.3, 0.7, 0.01]), 14.0
    found, _, _ = drive_twice(drift, np.zeros(3), room=HALL, begin=begin, end=35.0, until=15.0)
    assert found
    seen_at = [match.relative[0] for match in found[0].matches]
    assert min(seen_at) < -REFERENCE_DISTANCE  # metres before the first pass
    assert seen_at == sorted(seen_at)
    left = se2.compose(found[0].correction, drift)
    assert np.hypot(*left[:2]) < 0.15
    assert abs(left[2]) < 0.01


def test_looks_before_the_one_that_proposes_a_loop_count_only_if_they_contradict_the_estimate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The estimate has the robot where nothing is mapped: it may be at another place that looks alike."""

    def without_estimate(look: Look, motion: se2.Pose) -> Vote | None:
        return vote_in_view(look, motion) if motion.any() else None

    monkeypatch.setattr(look_back, "vote_in_view", without_estimate)
    drift = np.array([0.3, 0.7, 0.01])
    assert drive_twice(drift, np.zeros(3), room=HALL, begin=14.0, end=35.0, until=15.0)[0] == []


def look_from_beside() -> Look:
    """Return a look from 6 m beside the path of the first pass, where the estimate has the robot, give or take 3 m."""
    inside, beside = np.array([8.0, 1.5, 0.0]), np.array([8.0, 7.5, 0.0])
    state, local_field = StubMap(np.diag([3.0, 3.0, 0.05]) ** 2), LocalField()
    for seen_from, travelled in ((inside, 0.0), (beside, 2.0 * REVISIT_GAP)):
        points = with_noise(visible(COURT, seen_from), np.random.default_rng(0))
        local_field.add(ScanFeatures(NO_SEGMENTS, NO_CORNERS, ScanPoints(points)))
        state.keyframe_poses = np.vstack([state.keyframe_poses, inside])
        state.travelled.append(travelled)
        local_field.update(state.keyframe_count - 1, state.keyframe_poses, state.travelled)
    return Look(state, local_field, Submaps())  # type: ignore[arg-type]


def test_the_robot_is_searched_beside_the_path_only_while_the_estimate_is_in_doubt() -> None:
    look = look_from_beside()
    found = [[match.pose for match in some.search(0)] for some in (look, look.doubting_estimate())]
    right = [[pose for pose in poses if np.hypot(*(pose - [0.0, 6.0, 0.0])[:2]) < 0.1] for poses in found]
    assert (len(right[0]), len(right[1])) == (0, 1)


def test_a_hypothesis_is_not_searched_beyond_its_old_place_however_uncertain_the_motion_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Otherwise the time grows with the square of the uncertainty. Other places are searched by themselves."""
    searched: list[float] = []

    def search(submap: Submap, old: Submap, prediction: se2.Pose, reach: float, turn: float) -> list[SubmapMatch]:
        searched.append(reach)
        return []

    monkeypatch.setattr(look_module, "search_submap", search)
    monkeypatch.setattr(LocalField, "is_undetermined", lambda *_: True)
    look = look_from_beside()
    for some in (look, look.doubting_estimate()):
        some.test(0, np.zeros(3), 0)
    assert searched == [REFERENCE_DISTANCE, DOUBTED_REACH]


@pytest.mark.slow
def test_interruptions_do_not_change_what_is_accepted() -> None:
    drift = np.array([0.3, 0.9, 0.08])
    expected, found = (drive_twice(drift, np.zeros(3), interrupted=some)[0] for some in (False, True))
    assert len(found) == len(expected) > 0
    for before, after in zip(expected, found, strict=True):
        np.testing.assert_array_equal(after.correction, before.correction)
        assert [match.keyframe for match in after.matches] == [match.keyframe for match in before.matches]


def test_return_without_drift_links_the_passes_and_corrects_nothing() -> None:
    found, local_field, agreement = drive_twice(np.array([0.01, -0.01, 0.002]), np.zeros(3))
    assert found == []
    assert local_field.state.links
    returns = summarise(agreement.returns)
    assert returns["count"] == 1
    assert returns["looks"] == len(agreement.returns) >= MIN_SUPPORT
    assert 0.0 < returns["position_rms"] <= returns["position_max"] < 0.05  # the drift is 0.014 m
    assert agreement.take_rejected(ended=True) == []


def test_similar_room_elsewhere_is_not_taken_for_the_first_one() -> None:
    """The estimate is right to half a metre, and the copy of the room is six metres beside the first."""
    found, local_field, agreement = drive_twice(np.zeros(3), np.array([0.0, 6.0, 0.0]))
    assert found == []
    assert not local_field.state.links
    assert agreement.returns == []


def test_a_larger_drift_is_proposed_to_the_evidence_of_the_drive_where_the_estimate_is_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The drive ends too early for four looks. Parts of the map are never joined so early."""
    drift = np.array([0.3, 0.9, 0.08])
    assert drive_twice(drift, np.zeros(3), until=5.0, proposed=True)[0] == []
    monkeypatch.setattr(LoopAgreement, "_is_estimate_in_doubt", lambda *_: True)
    first, *_ = drive_twice(drift, np.zeros(3), until=5.0, proposed=True)[0]
    assert len(first.matches) == MIN_SUPPORT
    assert {check.name for check in first.checks if not check.passed} == {SUPPORT, SPAN}
    assert np.hypot(*se2.compose(first.correction, drift)[:2]) < 0.15
    assert drive_twice(drift, np.zeros(3), until=5.0, apart=True, proposed=True)[0] == []


def test_rejected_loop_states_what_was_missing() -> None:
    """The place fits, but the drive ends before it has been as far away as drift may have moved it."""
    uncertain = np.array([3.0, 3.0, 0.05])
    found, _, agreement = drive_twice(
        np.array([0.3, 0.9, 0.08]), np.zeros(3), until=5.0, sigmas=uncertain, proposed=True
    )
    assert found == []
    copied = copy.deepcopy(agreement)
    rejected = agreement.take_rejected(ended=True)
    assert [decision.status for decision in rejected] == [LoopStatus.REJECTED] * len(rejected)
    nearest = max(rejected, key=lambda decision: decision.margin)
    failed = [check for check in nearest.checks if not check.passed]
    assert nearest.margin == min(check.margin for check in failed) < 1.0
    assert f"{len(nearest.matches)} looks agree (requires {MIN_INDEPENDENT})" in nearest.reason
    assert "the positions that the looks show are up to" in nearest.reason
    assert len(nearest.reason.split("; ")) == len(failed)
    assert [d.reason for d in copied.take_rejected(ended=True)] == [d.reason for d in rejected]


def test_parts_are_joined_although_nothing_has_to_be_corrected() -> None:
    """They are where odometry has put them, which is no hypothesis, so looks must agree on that as on any other."""
    found, _, _ = drive_twice(np.array([0.01, -0.01, 0.002]), np.zeros(3), apart=True)
    assert found[0].joins
    assert len(found[0].matches) >= MIN_SUPPORT
    assert found[0].since == len(np.arange(1.0, 15.0, STEP))  # the whole part


def test_part_in_a_similar_room_is_not_joined() -> None:
    assert drive_twice(np.zeros(3), np.array([0.0, 6.0, 0.0]), apart=True)[0] == []


def matches_along_a_hall(state: StubMap, shifts: list[float]) -> tuple[Look, list[LoopMatch]]:
    """Drive 60 m, and return the last look and a match for each of some shifts along the hall (metres)."""
    local_field = LocalField()
    nothing = ScanFeatures(NO_SEGMENTS, NO_CORNERS, ScanPoints(np.zeros((0, 2))))
    for x in np.arange(0.0, 60.0, STEP):
        state.keyframe_poses = np.vstack([state.keyframe_poses, [x, 0.0, 0.0]])
        state.travelled.append(float(x))
        local_field.add(nothing)
    matches = [
        LoopMatch(k, 0, np.array([k * STEP + shift, 0.0, 0.0]), np.diag([0.05, 0.05, 0.01]) ** 2, k * STEP, 1.0, 1.0)
        for k, shift in zip(range(80, 120, 8), shifts, strict=True)
    ]
    return Look(state, local_field, Submaps()), matches  # type: ignore[arg-type]


def vote_for(motion: se2.Pose, fit: float = 0.97) -> Vote:
    """Return a good vote for a motion in the map; the old place is at the origin."""
    pose = se2.compose(motion, np.array([59.5, 0.0, 0.0]))
    return Vote(0, SubmapMatch(pose, np.diag([0.05, 0.05, 0.01]) ** 2, fit=fit, known=0.9), motion)


def test_match_that_leaves_the_estimate_supports_the_hypothesis_of_the_place_that_it_reaches() -> None:
    """It must not count for the estimate, or the looks at that place before it would not count."""
    look, matches = matches_along_a_hall(StubMap(np.diag([1.0, 1.0, 0.1]) ** 2), [0.0] * 5)
    agreement, motion = LoopAgreement(), np.array([0.6, 0.2, 0.0])
    agreement.restore(LoopAgreementState(hypotheses=[LoopHypothesis(motion, list(matches))]), LocalField())
    (hypothesis,) = agreement._hypotheses
    agreement._count_votes(look, Votes(vote_for(motion), [(hypothesis, vote_for(motion))], []), LocalField())
    (followed,) = agreement.state.hypotheses
    assert [match.travelled for match in followed.support] == [*(match.travelled for match in matches), look.travelled]
    assert agreement.state.contradictions == (look.travelled,)


@pytest.mark.parametrize("tested", [False, True])
def test_better_match_elsewhere_contradicts_a_hypothesis_only_if_another_look_has_proposed_it(*, tested: bool) -> None:
    look, matches = matches_along_a_hall(StubMap(np.diag([1.0, 1.0, 0.1]) ** 2), [0.0] * 5)
    agreement, motion, elsewhere = LoopAgreement(), np.array([0.6, 0.2, 0.0]), np.array([1.8, 0.0, 0.0])
    followed = [LoopHypothesis(motion, list(matches)), *([LoopHypothesis(elsewhere, matches[:1])] if tested else [])]
    agreement.restore(LoopAgreementState(hypotheses=followed), LocalField())
    votes = [vote_for(motion, fit=0.8), vote_for(elsewhere, fit=1.0)]
    counted = list(zip(agreement._hypotheses, votes, strict=False))
    agreement._count_votes(look, Votes(None, counted, votes[len(counted) :]), LocalField())
    hypothesis, rival = agreement.state.hypotheses
    assert len(hypothesis.support) == len(matches)
    assert hypothesis.contradictions == ([look.travelled] if tested else [])
    assert rival.support[-1].keyframe == look.last
    assert agreement._accepted(look) is None


@pytest.mark.parametrize(("contradicted", "accepted"), [([], False), ([40.0, 46.0, 52.0, 58.0], True)])
def test_looks_that_contradict_the_estimate_put_its_uncertainty_in_doubt(
    contradicted: list[float], accepted: bool
) -> None:
    """The looks agree on a motion of 3.5 standard deviations."""
    motion = np.array([1.1, 0.0, 0.0])
    look, matches = matches_along_a_hall(StubMap(np.diag([0.1, 0.1, 0.02]) ** 2), [motion[0]] * 5)
    hypothesis, agreement = LoopHypothesis(motion, matches), LoopAgreement()
    agreement.restore(LoopAgreementState(contradictions=contradicted, hypotheses=[hypothesis]), LocalField())
    (followed,) = agreement._hypotheses
    agreement._count_votes(look, Votes(None, [(followed, vote_for(motion))], []), LocalField())
    decision = agreement._accepted(look)
    assert (decision is not None) == accepted
    assert decision is None or decision.doubted


@pytest.mark.parametrize("looks", [3, 4])
def test_looks_that_put_the_estimate_in_doubt_are_unresolved_until_one_agrees_with_it(looks: int) -> None:
    contradicted, agreement = [40.0, 46.0, 52.0, 58.0][:looks], LoopAgreement()
    agreement.restore(LoopAgreementState(contradictions=contradicted), LocalField())
    assert agreement.unresolved == (tuple(contradicted) if looks == 4 else ())
    look, _ = matches_along_a_hall(StubMap(np.diag([0.3, 0.3, 0.03]) ** 2), [0.0] * 5)
    agreement._count_votes(look, Votes(vote_for(np.zeros(3)), [], []), LocalField())
    assert not agreement.unresolved


def test_match_that_corrects_the_estimate_a_little_is_a_hypothesis_and_no_contradiction() -> None:
    look, _ = matches_along_a_hall(StubMap(np.diag([0.3, 0.3, 0.03]) ** 2), [0.0] * 5)
    agreement = LoopAgreement()
    agreement._count_votes(look, Votes(vote_for(np.array([0.4, 0.0, 0.0])), [], []), LocalField())
    (proposed,) = agreement.state.hypotheses
    assert proposed.motion[0] == 0.4
    assert not agreement.state.contradictions


def test_the_submap_of_a_match_does_not_show_what_was_driven_in_another_part() -> None:
    state = StubMap(np.diag(SIGMAS**2))
    look, matches = matches_along_a_hall(state, [0.0] * 5)
    assert look.distance_shown_before(matches[0]) == SUBMAP_LENGTH
    first = matches[0].keyframe - 4
    state.landmarks.parts.begin(first, measured=True)
    assert look.distance_shown_before(matches[0]) == matches[0].travelled - state.travelled[first]


@pytest.mark.parametrize(("room", "passed"), [(30.0, True), (4.0, False)])
def test_what_looks_show_must_lead_as_far_as_the_position_may_be_wrong(room: float, *, passed: bool) -> None:
    """The robot drives 25 m, ahead or to and fro in a room, and its position may be wrong by 9 m."""
    state = StubMap(np.diag([3.0, 0.5, 0.05]) ** 2)
    look, matches = matches_along_a_hall(state, [0.0] * 5)
    state.keyframe_poses[:, 0] = room - np.abs(np.asarray(state.travelled) % (2 * room) - room)
    checks = {check.name: check for check in support_checks(LoopHypothesis(np.zeros(3), matches), look, 0, joins=False)}
    assert checks["span"].passed
    assert checks["extent"].passed == passed
    assert checks["extent"].gate == pytest.approx(NORMAL_LIMIT * np.hypot(3.0, UNMODELLED_SIGMAS[0]))
    assert checks["extent"].value == pytest.approx(25.5 if passed else room)


def test_looks_that_contradict_the_others_do_not_count() -> None:
    """One match slid along a wall by 1.5 m, which odometry between the looks does not admit."""
    state = StubMap(np.diag([0.05, 0.05, 0.01]) ** 2)
    look, matches = matches_along_a_hall(state, [0.0, -1.5, 0.1, 0.0, 0.1])
    assert [match.keyframe for match in look.consistent(matches)] == [80, 96, 104, 112]


def test_only_looks_that_differ_need_the_covariance_between_them() -> None:
    """It takes long in a large map, and there are as many as pairs of looks."""
    state = StubMap(np.diag([0.6, 0.6, 0.01]) ** 2)  # admits 1.5 m
    look, matches = matches_along_a_hall(state, [0.0, -1.5, 0.1, 0.0, 0.1])
    assert look.consistent(matches) == matches
    assert state.asked == [(88, 96), (88, 104), (88, 112), (80, 88)]
