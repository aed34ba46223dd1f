"""Separation of a pass from earlier ones: its observations of their landmarks become those of landmarks of its own."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from drivers import se2
from slam.geometry.segments import CornerPoints, Segments
from slam.graph.factors import FactorKind
from slam.mapping.data_association import UNMATCHED, RowAssociation
from slam.mapping.keyframes import KeyframeMotion
from slam.mapping.local_map import empty_local_map
from slam.mapping.manual_changes import tie_walls
from slam.mapping.mapper import Mapper
from slam.mapping.pass_separation import Pass, separate_pass

from .wall_groups import assert_merged_walls_are_equal_in_the_graph

WALLS = np.array([[3.0, 0.0, 0.0, 3.0], [6.0, 2.0, np.pi / 2, 2.0], [3.0, 4.0, np.pi, 3.0]])
"""Frames and half lengths of the walls of a room."""
AWAY, AGAIN = 10, 18
"""First keyframe out of the room, and first one in it again."""
COUNT = 23
GAP = 5.0
STEP = 1.0


def drive(mapper: Mapper) -> list[Segments]:
    """Drive in the room, out of it and back, with walls and a corner that are recognised; return the segments."""
    views: list[Segments] = []
    for k in range(COUNT):
        outside = AWAY <= k < AGAIN
        pose = np.array([2.0 + 0.1 * (k % 5), 2.0, 0.05 * (k % 3)])
        walls = WALLS[:0] if outside else WALLS
        motion = np.array([STEP, 0.0, 0.0])
        frames = se2.between(pose, walls[:, :3]).reshape(-1, 3)
        segments = Segments(frames, walls[:, 3], np.tile(np.diag([0.01, 0.01]) ** 2, (len(walls), 1, 1)))
        seen = int(not outside)
        positions = se2.transform(se2.inverse(pose), np.array([[6.0, 0.0]])[:seen]).reshape(-1, 2)
        corners = CornerPoints(
            positions, np.tile(1e-4 * np.eye(2), (seen, 1, 1)), np.array([[0, 1]])[:seen], np.zeros((seen, 2))
        )
        local, known = empty_local_map(), k > 0 and not outside
        if known:
            fields = {name: getattr(local, name) for name in local.__slots__}
            local = type(local)(**fields | {"walls": np.arange(len(WALLS)), "corners": np.arange(seen)})
        rows = np.arange(len(walls)) if known else np.full(len(walls), UNMATCHED)
        corner_rows = np.arange(seen) if known else np.full(seen, UNMATCHED)
        association = RowAssociation(rows, np.zeros(len(walls)), rows, corner_rows, np.zeros(seen), corner_rows)
        step = None if k == 0 else KeyframeMotion(k - 1, motion, np.diag([0.5, 0.5, 0.5]) ** 2)
        mapper.refresh(mapper.add_keyframe(pose, step, segments, corners, association, local))
        views.append(segments)
    mapper.solve_waiting()
    mapper.graph.update_until_converged(30)  # odometry is far off, so that it takes many steps
    mapper.read_back_all()
    return views


@pytest.fixture
def driven() -> tuple[Mapper, list[Segments]]:
    mapper = Mapper()
    return mapper, drive(mapper)


def second_pass(until: int = COUNT) -> Pass:
    return Pass(range(AWAY, until), GAP)


def shown(mapper: Mapper) -> list[int]:
    return np.flatnonzero(mapper.landmarks.active() & mapper.landmarks.walls.rows["in_graph"]).tolist()


def test_a_pass_gets_landmarks_of_its_own_and_nothing_holds_it(driven: tuple[Mapper, list[Segments]]) -> None:
    mapper, segments = driven
    before = mapper.keyframe_poses.copy()
    of_pass = separate_pass(mapper, second_pass(), segments)
    rows = mapper.landmarks.walls.rows
    assert shown(mapper) == [0, 1, 2, 3, 4, 5]
    assert np.flatnonzero(of_pass).tolist() == [3, 4, 5]
    np.testing.assert_array_equal(rows["observations"][:6], [AWAY] * 3 + [COUNT - AGAIN] * 3)
    np.testing.assert_array_equal(rows["first_seen"][:6], [0] * 3 + [AGAIN] * 3)
    np.testing.assert_array_equal(rows["last_seen"][:6], [AWAY - 1] * 3 + [COUNT - 1] * 3)
    np.testing.assert_allclose(rows["high"][:6] - rows["low"][:6], 2 * np.tile(WALLS[:, 3], 2), atol=0.02)
    np.testing.assert_array_equal(mapper.landmarks.corners.rows["observations"][:2], [AWAY, COUNT - AGAIN])
    assert {tuple(ids.walls.tolist()) for ids in mapper.landmark_ids[AGAIN:]} == {(3, 4, 5)}
    assert {tuple(ids.corners.tolist()) for ids in mapper.landmark_ids[AGAIN:]} == {(1,)}
    # Only odometry leads to the pass now, which says that the robot has driven on.
    np.testing.assert_allclose(mapper.keyframe_poses[:AWAY], before[:AWAY], atol=0.01)
    assert np.hypot(*(mapper.keyframe_poses[-1] - before[-1])[:2]) > 5.0
    # The walls of the pass are where its keyframes observe them.
    frames = se2.compose(mapper.keyframe_poses[-1], segments[-1].frame)
    np.testing.assert_allclose(se2.between(rows["frame"][3:6], frames)[:, 1:], 0.0, atol=0.01)


def test_the_keyframes_after_a_pass_keep_their_landmarks(driven: tuple[Mapper, list[Segments]]) -> None:
    mapper, segments = driven
    separate_pass(mapper, second_pass(until=COUNT - 2), segments)
    last_ids = [ids.walls.tolist() for ids in mapper.landmark_ids[-3:]]
    assert last_ids == [[3, 4, 5], [0, 1, 2], [0, 1, 2]]


def test_landmarks_that_are_still_seen_are_not_divided(driven: tuple[Mapper, list[Segments]]) -> None:
    mapper, segments = driven
    poses, factors = mapper.keyframe_poses.copy(), mapper.graph.factor_count
    of_pass = separate_pass(mapper, Pass(range(4, AWAY), GAP), segments)
    assert not of_pass.any()
    assert mapper.graph.factor_count == factors
    np.testing.assert_allclose(mapper.keyframe_poses, poses, atol=1e-3)


def test_walls_merged_across_passes_are_unmerged_unless_a_person_has_tied_them(
    driven: tuple[Mapper, list[Segments]],
) -> None:
    mapper, segments = driven
    separate_pass(mapper, second_pass(), segments)
    for old, recent in ((0, 3), (1, 4)):
        tie_walls(mapper, old, recent)
    assert shown(mapper) == [0, 1, 2, 5]
    tied = copy.deepcopy(mapper)
    separate_pass(mapper, second_pass(), segments)
    assert shown(mapper) == [0, 1, 2, 3, 4, 5]
    assert not [f for f in mapper.graph.solver.factors.values() if f.kind is FactorKind.WALL_EQUALITY]
    np.testing.assert_array_equal(mapper.landmarks.walls.rows["observations"][:6], [AWAY] * 3 + [COUNT - AGAIN] * 3)
    separate_pass(tied, second_pass(), segments, ties=[(0, 3)])
    assert shown(tied) == [0, 1, 2, 4, 5]
    assert tied.landmarks.walls.rows["observations"][0] == AWAY + COUNT - AGAIN
    assert_merged_walls_are_equal_in_the_graph(tied)


def test_walls_that_the_pass_has_removed_are_there_again(driven: tuple[Mapper, list[Segments]]) -> None:
    mapper, segments = driven
    mapper.landmarks.remove_wall(0, AGAIN + 1)
    mapper.landmarks.open_wall(1, [0, 1, 2], AGAIN + 1)
    mapper.landmarks.open_wall(2, [3], AWAY - 2)
    separate_pass(mapper, second_pass(), segments)
    assert {0, 1, 2} <= set(shown(mapper))
    assert mapper.landmarks.opened.get(1, {}) == {}
    assert mapper.landmarks.opened[2] == {3: AWAY - 2}


def test_walls_merged_since_then_are_separated_if_a_gap_lies_between(driven: tuple[Mapper, list[Segments]]) -> None:
    """Keyframes just before the pass have seen its place from a distance: their walls are those of the old place."""
    mapper, segments = driven
    separate_pass(mapper, second_pass(), segments)
    for old, recent in ((0, 3), (1, 4)):
        tie_walls(mapper, old, recent)
    of_pass = separate_pass(mapper, Pass(range(AGAIN + 2, COUNT), GAP), segments, merged=[(0, 3)])
    assert shown(mapper)[:3] == [0, 1, 2]
    rows = mapper.landmarks.walls.rows
    assert rows["merged_into"][3] == 3
    assert rows["merged_into"][4] == 1
    assert rows["observations"][0] == AWAY
    assert not of_pass[:5].any()
    assert_merged_walls_are_equal_in_the_graph(mapper)
