"""Closing of a loop: the pose is corrected and walls are merged, or the closure is rejected."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from drivers import se2
from slam.estimation.map_view import map_features
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.graph.factors import FactorKind
from slam.loop_closure.closing import add_return, close_loop
from slam.loop_closure.decision import LoopDecision, LoopMatch
from slam.loop_closure.loop_status import LoopStatus
from slam.mapping.data_association import UNMATCHED, RowAssociation
from slam.mapping.keyframes import KeyframeMotion
from slam.mapping.local_map import empty_local_map
from slam.mapping.mapper import Mapper

from ..mapping.wall_groups import assert_merged_walls_are_equal_in_the_graph

# Room with unequal sides and a niche: frames of the walls, seen from inside, and their half lengths.
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
WHEELS = np.diag([0.05, 0.05, 0.03]) ** 2
"""Covariance (3, 3) of a motion by wheels."""


def observe(
    mapper: Mapper,
    pose: se2.Pose,
    motion: se2.Pose,
    walls: Floats,
    known: list[int] | None,
    covariance: Floats = WHEELS,
) -> list[int]:
    """Add a keyframe that sees all walls, as new ones or as the `known` ids; return their ids.

    The motion to it from the last keyframe has the covariance (3, 3).

    It also sees the corner between the first two walls, if there are two: each pass has one.
    """
    frames = se2.between(pose, walls[:, :3])
    segments = Segments(frames, walls[:, 3], np.tile(np.diag([0.01, 0.01]) ** 2, (len(walls), 1, 1)))
    seen = int(len(walls) > 1)
    corners = CornerPoints(
        np.array([se2.transform(frames[k], np.array([walls[k, 3], 0.0])) for k in range(seen)]).reshape(-1, 2),
        np.tile(np.diag([0.01, 0.01]) ** 2, (seen, 1, 1)),
        np.array([[0, 1]])[:seen],
        frames[: 2 * seen, 2].reshape(seen, 2),
    )
    rows = np.full(len(walls), UNMATCHED) if known is None else np.arange(len(walls))
    local = empty_local_map()
    if known is not None:
        corner = np.array([known[0] // len(walls)])[:seen]  # 0 in the first pass, 1 in the second
        named = {name: getattr(local, name) for name in local.__slots__}
        local = type(local)(**{**named, "walls": np.array(known), "corners": corner})
    association = RowAssociation(rows, np.zeros(len(walls)), rows, rows[:seen], np.zeros(seen), rows[:seen])
    first = mapper.keyframe_count == 0
    step = None if first else KeyframeMotion(mapper.keyframe_count - 1, motion, covariance)
    view = mapper.add_keyframe(pose, step, segments, corners, association, local)
    mapper.refresh(view)
    return [int(wall) for wall in view.association.walls]


def drifted_mapper(drift: se2.Pose) -> tuple[Mapper, list[int], list[int]]:
    """Map the room twice, the second time after odometry has drifted by `drift`; return the ids of both passes."""
    mapper = Mapper()
    first = observe(mapper, INSIDE, np.zeros(3), ROOM, None)
    step = np.array([0.05, 0.0, 0.0])
    pose = se2.compose(INSIDE, step)
    observe(mapper, pose, step, ROOM, first)
    none = ROOM[:0]
    for _ in range(8):  # sees nothing
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
    mapper.solve_waiting()
    return mapper, first, second


def mapper_of_two_parts(drift: se2.Pose, covariance: Floats = WHEELS) -> tuple[Mapper, list[int], list[int]]:
    """Map the room in two parts of the map, the second one displaced by `drift` and with one wall mapped twice.

    The motion between the parts has the covariance (3, 3).
    Returns the ids of the walls of both parts; the last one of the second part is the duplicate of its first one.
    """
    mapper = Mapper()
    first = observe(mapper, INSIDE, np.zeros(3), ROOM, None)
    observe(mapper, INSIDE, np.zeros(3), ROOM, first)
    mapper.begin_part(measured=True)
    moved = np.column_stack([se2.compose(drift, ROOM[:, :3]), ROOM[:, 3]])
    second = observe(mapper, se2.compose(drift, INSIDE), np.zeros(3), moved, None, covariance)
    observe(mapper, mapper.pose, np.zeros(3), moved, second)
    again = observe(mapper, mapper.pose, np.zeros(3), moved[:1], None)
    observe(mapper, mapper.pose, np.zeros(3), moved[:1], again)
    return mapper, first, second + again


def agreeing_decision(mapper: Mapper, relatives: list[se2.Pose]) -> LoopDecision:
    """Return a confirmed decision with a match of the last keyframe with the first one for each relative pose."""
    last, matches = mapper.keyframe_count - 1, [match_with_start(mapper, relative) for relative in relatives]
    return LoopDecision(
        candidate=1,
        keyframe=last,
        old=0,
        motion=np.zeros(3),
        correction=np.zeros(3),
        status=LoopStatus.CONFIRMED,
        reason="the matches agree",
        matches=tuple(matches),
        runner_up=0.0,
        contradicted=0.0,
        checks=(),
        since=mapper.keyframe_count - 2,
        compared=(np.zeros((0, 2)), np.zeros((0, 2))),
    )


def test_matches_that_agree_correct_the_pose_and_merge_walls_that_coincide_then() -> None:
    mapper, first, second = drifted_mapper(np.array([1.6, -1.0, 0.2]))
    relative = np.array([0.05, 0.0, 0.0])
    closed = close_loop(mapper, agreeing_decision(mapper, 4 * [relative]))
    assert closed.status is LoopStatus.ACCEPTED
    np.testing.assert_allclose(mapper.pose, se2.compose(INSIDE, relative), atol=0.01)
    assert set(closed.merged) == set(zip(first, second, strict=True))
    factors = list(mapper.graph.solver.factors.values())
    loops = [factor for factor in factors if factor.kind is FactorKind.LOOP]
    assert len(loops) == 4
    assert all(factor.covariance[0, 0] >= 0.03**2 for factor in loops)  # those that only moved the map are removed


def test_walls_merged_just_before_a_join_stay_one_in_the_graph() -> None:
    """Their equality waits for the next update of the graph, with the factors that only move the part into place."""
    drift = np.array([3.0, -1.0, 0.2])
    mapper, first, second = mapper_of_two_parts(drift)
    mapper.merge_walls(second[0], second[-1])
    decision = agreeing_decision(mapper, 4 * [np.zeros(3)])
    decision = replace(decision, correction=se2.inverse(drift), joins=True)
    assert close_loop(mapper, decision).status is LoopStatus.ACCEPTED
    np.testing.assert_allclose(mapper.pose, INSIDE, atol=0.01)
    assert mapper.landmarks.walls.rows["merged_into"][second[-1]] == first[0]
    assert_merged_walls_are_equal_in_the_graph(mapper)


def test_a_part_is_joined_without_qr_although_odometry_hardly_connects_it() -> None:
    """After a robot was carried far, odometry's motion is a million times as uncertain as what the scans show."""
    drift = np.array([3.0, -1.0, 0.2])
    mapper, _, _ = mapper_of_two_parts(drift, np.diag([1e4, 1e4, 3.0]) ** 2)
    decision = replace(agreeing_decision(mapper, 4 * [np.zeros(3)]), correction=se2.inverse(drift), joins=True)
    assert close_loop(mapper, decision).status is LoopStatus.ACCEPTED
    assert not mapper.graph.solver.qr
    np.testing.assert_allclose(mapper.pose, INSIDE, atol=0.01)
    of_part = mapper.pose_covariances[mapper.landmarks.parts.firsts[-1] :]
    np.testing.assert_array_equal(of_part, np.tile(of_part[-1], (len(of_part), 1, 1)))  # no drift within the part


def test_a_corner_of_merged_walls_is_one_corner_of_the_map() -> None:
    mapper, first, _ = drifted_mapper(np.array([1.6, -1.0, 0.2]))
    assert len(map_features(mapper)[1]) == 2
    close_loop(mapper, agreeing_decision(mapper, 4 * [np.array([0.05, 0.0, 0.0])]))
    _, corners = map_features(mapper)
    assert (corners.identity.tolist(), corners.walls.tolist()) == ([0], [first[:2]])
    assert corners.observations.tolist() == [4]
    np.testing.assert_allclose(corners.position[0], (6.0, 0.0), atol=0.01)


def test_matches_that_contradict_each_other_are_rejected() -> None:
    mapper, _, _ = drifted_mapper(np.array([1.6, -1.0, 0.2]))
    relatives = [np.array([0.05, 0.0, 0.0]), np.array([0.05, 0.8, 0.0])]
    before, factors = mapper.graph.keyframe_poses(mapper.keyframe_count), mapper.graph.factor_count
    rejected = close_loop(copy.deepcopy(mapper), agreeing_decision(mapper, 2 * relatives))
    assert rejected.status is LoopStatus.REJECTED
    assert "do not fit" in rejected.reason
    assert rejected.merged == ()
    # closing on a copy does not change the original
    np.testing.assert_allclose(mapper.graph.keyframe_poses(mapper.keyframe_count), before, atol=1e-12)
    assert mapper.graph.factor_count == factors


def match_with_start(mapper: Mapper, relative: se2.Pose) -> LoopMatch:
    """Return a match of the last keyframe with the first one, with standard deviations of 3 cm and half a degree."""
    last, covariance = mapper.keyframe_count - 1, np.diag([0.03, 0.03, 0.01]) ** 2
    return LoopMatch(last, 0, relative, covariance, mapper.travelled[-1], 0.95, 0.9)


def test_returns_correct_drift_where_no_landmark_holds_the_robot() -> None:
    """Odometry is 0.1 m wrong when the robot is back, as along a corridor whose walls say nothing about it."""
    mapper, pose = Mapper(), INSIDE
    observe(mapper, pose, np.zeros(3), ROOM[:0], None)
    for motion in ([0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.1, 0.0, 0.0]):
        pose = se2.compose(pose, np.array(motion))
        observe(mapper, pose, np.array(motion), ROOM[:0], None)
    mapper.solve_waiting()
    for _ in range(3):
        add_return(mapper, match_with_start(mapper, np.zeros(3)))
    mapper.graph.update()
    mapper.graph.update_until_converged()
    mapper.read_back_all()
    assert np.hypot(*(mapper.pose - INSIDE)[:2]) < 0.03


def test_returns_that_share_points_are_added_once() -> None:
    """The points of a look are those of the last 6 m."""
    mapper, pose = Mapper(), INSIDE
    observe(mapper, pose, np.zeros(3), ROOM[:0], None)
    counts = []
    for _ in range(8):
        motion = np.array([2.0, 0.0, 0.0])
        pose = se2.compose(pose, motion)
        observe(mapper, pose, motion, ROOM[:0], None)
        add_return(mapper, match_with_start(mapper, se2.between(INSIDE, pose)))
        mapper.graph.update()
        factors = mapper.graph.solver.factors.values()
        counts.append(sum(factor.kind is FactorKind.SUBMAP_MATCH for factor in factors))
    assert counts == [1, 1, 1, 2, 2, 2, 3, 3]


def test_returns_do_not_hold_a_pass_that_a_closure_moves() -> None:
    """Looks may agree with a wrong estimate where rooms are alike; what they tied is removed with the walls."""
    mapper, _, _ = drifted_mapper(np.array([15.0, -1.0, 0.2]))
    add_return(mapper, match_with_start(mapper, se2.between(mapper.keyframe_poses[0], mapper.pose)))
    mapper.graph.update()
    relative = np.array([0.05, 0.0, 0.0])
    assert close_loop(mapper, agreeing_decision(mapper, 4 * [relative])).status is LoopStatus.ACCEPTED
    assert not [f for f in mapper.graph.solver.factors.values() if f.kind is FactorKind.SUBMAP_MATCH]
    np.testing.assert_allclose(mapper.pose, se2.compose(INSIDE, relative), atol=0.01)
