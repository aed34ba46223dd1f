"""Relocalisation: the right place is found from any pose, and what is ambiguous, undetermined or foreign is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import Result

from drivers import se2
from drivers.messages import GroundTruth, Message
from drivers.simulation import Simulation
from slam.geometry.segments import Floats, Segments
from slam.loop_closure.map_descriptor import MapDescriptor, describe_map
from slam.loop_closure.relocalisation import MapIndex, Relocalisation, Submap, index_map, relocalise, submap_of
from slam.loop_closure.visibility import look
from slam.loop_closure.wall_pairs import pair_table
from slam.mapping.landmarks import Landmarks
from slam.pipeline import Slam

FLATNESS = 1e-6


def room(x: float, y: float, width: float, depth: float, niche: float) -> Floats:
    """Walls (6, 4) of a room with a niche at its upper left: frames seen from inside, and half their lengths."""
    middle = 0.5 * width
    return np.array(
        [
            [x + middle, y, 0.0, middle],
            [x + width, y + depth / 2, np.pi / 2, depth / 2],
            [x + 0.75 * width, y + depth, np.pi, 0.25 * width],
            [x + middle, y + depth + niche / 2, np.pi / 2, niche / 2],
            [x + 0.25 * width, y + depth + niche, np.pi, 0.25 * width],
            [x, y + (depth + niche) / 2, -np.pi / 2, (depth + niche) / 2],
        ]
    )


ROOMS = [room(7.0 * k, 0.0, 4.0 + 0.4 * k, 3.0 + 0.5 * ((3 * k) % 5), 0.8 + 0.3 * ((2 * k) % 3)) for k in range(5)]
INSIDE = [np.array([7.0 * k + 2.0, 1.5, 0.4]) for k in range(5)]
BOX = np.array([[2.0, 1.5, np.pi, 0.5], [2.5, 2, -np.pi / 2, 0.5], [2, 2.5, 0, 0.5], [1.5, 2, np.pi / 2, 0.5]])
SQUARE = np.array([[2.0, 0, 0, 2], [4, 2, np.pi / 2, 2], [2, 4, np.pi, 2], [0, 2, -np.pi / 2, 2]])


def landmarks_of(walls: Floats) -> Landmarks:
    """Walls (n, 4) that are confirmed and known to a centimetre and a tenth of a degree."""
    landmarks = Landmarks()
    for wall in walls:
        identity = landmarks.add_wall(wall[:3], wall[3], 0)
        landmarks.walls.rows["in_graph"][identity] = True
        landmarks.walls.rows["covariance"][identity] = np.diag([0.01, 0.002]) ** 2
    return landmarks


def index_of(walls: Floats) -> MapIndex:
    scene = describe_map(landmarks_of(walls), FLATNESS)
    return MapIndex(scene, pair_table(scene))


def fragment_at(pose: se2.Pose, walls: Floats, own: se2.Pose) -> Submap:
    """What is seen of walls in the map from `pose` there, in a frame in which that pose is `own`."""
    there = se2.compose(own, se2.inverse(pose))
    moved = np.column_stack([se2.compose(there, walls[:, :3]), walls[:, 3]])
    segments = Segments(se2.between(own, moved[:, :3]), walls[:, 3], np.tile(np.eye(2) * 1e-4, (len(walls), 1, 1)))
    return Submap(describe_map(landmarks_of(moved), FLATNESS), own, [(own, segments)])


@pytest.mark.parametrize("k", range(len(ROOMS)))
def test_a_room_is_found_among_others(k: int) -> None:
    own = np.array([0.3, -0.2, 2.0])
    found = relocalise(fragment_at(INSIDE[k], ROOMS[k], own), index_of(np.concatenate(ROOMS)))
    assert found is not None
    assert found.verdict.accepted, found.verdict.reason
    np.testing.assert_allclose(se2.between(INSIDE[k], found.pose), 0.0, atol=1e-3)
    np.testing.assert_allclose(se2.compose(found.motion, own), found.pose, atol=1e-9)
    assert sorted(map(tuple, found.pairs)) == [(6 * k + wall, wall) for wall in range(6)]
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()


coordinate = st.floats(-200.0, 200.0)


@settings(max_examples=10, deadline=None)
@given(st.tuples(coordinate, coordinate, st.floats(-np.pi, np.pi)))
def test_the_fragments_own_frame_does_not_matter(own: tuple[float, float, float]) -> None:
    """The pose in the map is the same whatever the fragment's frame; the motion undoes it."""
    index = index_of(np.concatenate(ROOMS))
    at_origin = relocalise(fragment_at(INSIDE[2], ROOMS[2], np.zeros(3)), index)
    moved = relocalise(fragment_at(INSIDE[2], ROOMS[2], np.array(own)), index)
    assert at_origin is not None
    assert moved is not None
    np.testing.assert_allclose(se2.between(at_origin.pose, moved.pose), 0.0, atol=1e-6)
    np.testing.assert_allclose(at_origin.covariance, moved.covariance, rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(se2.between(moved.motion, se2.compose(moved.pose, se2.inverse(own))), 0.0, atol=1e-6)
    assert moved.verdict.accepted == at_origin.verdict.accepted


def refused(found: Relocalisation | None, because: str) -> None:
    assert found is not None
    assert not found.verdict.accepted
    assert because in found.verdict.reason


def test_a_room_that_looks_the_same_from_four_sides_is_ambiguous() -> None:
    walls = np.concatenate([SQUARE, BOX])
    refused(relocalise(fragment_at(np.array([1.0, 1.5, 0.0]), walls, np.zeros(3)), index_of(walls)), "another place")


def test_four_walls_are_no_evidence() -> None:
    """They lie on some four walls of any building."""
    walls = np.concatenate(ROOMS)
    refused(relocalise(fragment_at(INSIDE[0], ROOMS[0][[0, 1, 2, 5]], np.zeros(3)), index_of(walls)), "no evidence")


def test_one_of_two_equal_rooms_is_ambiguous() -> None:
    twin = ROOMS[1] + np.array([50.0, 20.0, 0.0, 0.0])
    walls = np.concatenate([*ROOMS, twin])
    refused(relocalise(fragment_at(INSIDE[1], ROOMS[1], np.zeros(3)), index_of(walls)), "another place")


def test_a_twin_in_which_something_was_moved_is_ambiguous_all_the_same() -> None:
    """What is seen from there tells the two apart, but that may have been moved back."""
    away = np.array([50.0, 20.0, 0.0, 0.0])
    screens = np.array([[INSIDE[1][0] + 0.4, 1.5, -np.pi / 2, 1.4], [INSIDE[1][0] - 0.4, 1.5, np.pi / 2, 1.4]])
    index = index_of(np.concatenate([*ROOMS, ROOMS[1] + away, screens + away]))
    found = relocalise(fragment_at(INSIDE[1], ROOMS[1], np.zeros(3)), index)
    refused(found, "another place explains")
    assert found is not None
    assert found.verdict.runner_up < 0.6 * found.verdict.score


def test_parallel_walls_alone_propose_nothing() -> None:
    corridor = np.array([[x, y, h, 4.0] for x in (-4.0, 4.0, 12.0) for y, h in ((0.0, 0.0), (2.0, np.pi))])
    assert relocalise(fragment_at(np.array([1.0, 1.0, 0.0]), corridor, np.zeros(3)), index_of(corridor)) is None


def test_the_place_along_a_corridor_is_not_made_up() -> None:
    """Its end is known, but the fragment has seen only the sides and something that is not in the map."""
    sides = np.array([[5.0, 0.0, 0.0, 5.0], [5.0, 2.0, np.pi, 5.0]])
    end = np.array([[10.0, 1.0, np.pi / 2, 1.0]])
    cabinet = np.array([[4.0, 0.4, np.pi / 2, 0.4]])
    found = relocalise(
        fragment_at(np.array([3.0, 1.0, 0.0]), np.concatenate([sides, cabinet]), np.zeros(3)),
        index_of(np.concatenate([sides, end])),
    )
    assert found is None or not found.verdict.accepted


def test_equal_doors_along_a_corridor_are_ambiguous() -> None:
    jambs = [[x, y, np.pi / 2, 0.3] for x in np.arange(0.0, 40.0, 2.0) for y in (0.0, 2.0)]
    walls = np.array([*jambs, [20.0, -0.3, 0.0, 20.0], [20.0, 2.3, np.pi, 20.0]])
    near = np.array(
        [*[jamb for jamb in jambs if 14.0 < jamb[0] < 23.0], [18.0, -0.3, 0.0, 4.0], [18.0, 2.3, np.pi, 4.0]]
    )
    refused(relocalise(fragment_at(np.array([18.0, 1.0, 0.0]), near, np.zeros(3)), index_of(walls)), "another place")


def test_what_was_seen_through_walls_speaks_against_a_place() -> None:
    """The map has a partition in the room; from one side of it the other cannot have been seen."""
    partition = np.array([[3.5, 1.5, np.pi / 2, 1.2]])
    index = index_of(np.concatenate([*ROOMS, partition]))
    found = relocalise(fragment_at(np.array([1.5, 1.5, 0.0]), ROOMS[0], np.zeros(3)), index)
    refused(found, "seen through walls")


def test_sight_sorts_the_rays() -> None:
    scene: MapDescriptor = index_of(SQUARE).scene
    pose = np.array([2.0, 2.0, 0.7])
    views = fragment_at(pose, SQUARE, np.zeros(3)).views
    there = look(pose, views, scene)
    assert there.agreement == 1.0
    assert there.contradicted == 0.0
    assert there.agree > 100
    beyond = look(pose + np.array([2.5, 0.0, 0.0]), views, scene)
    assert beyond.contradicted > 0.1


def test_a_fragment_that_saw_next_to_nothing_is_no_place() -> None:
    index = index_of(np.concatenate(ROOMS))
    assert relocalise(fragment_at(INSIDE[0], ROOMS[0][:2], np.zeros(3)), index) is None
    assert relocalise(fragment_at(INSIDE[0], ROOMS[0], np.zeros(3)), index_of(ROOMS[0][:0])) is None


# --- with what a robot sees


def mapped(messages: list[Message]) -> Slam:
    slam = Slam()
    for message in messages:
        slam.add(message)
    return slam


def pieces(world: str, seed: int, seconds: float, starts: list[float]) -> Iterator[tuple[Slam, se2.Pose]]:
    """OdometrySegments of some seconds, each mapped on its own, with the true pose at the last keyframe."""
    messages = list(Simulation(world, seed=seed, duration=max(starts) + seconds + 1.0))
    for start in starts:
        piece = [message for message in messages if start <= message.stamp < start + seconds]
        slam = mapped(piece)
        truth = [message for message in piece if isinstance(message, GroundTruth)]
        at = slam.finish().keyframe_stamps[-1]
        yield slam, min(truth, key=lambda message: abs(message.stamp - at)).pose


@pytest.fixture(scope="module")
def office() -> tuple[MapIndex, se2.Pose]:
    """The map of a drive through an office, and where in the world the drive began."""
    messages = list(Simulation("office", seed=2, duration=60.0))
    first = next(message for message in messages if isinstance(message, GroundTruth))
    slam = mapped(messages)
    slam.finish()
    return index_map(slam.slam_state.mapper), first.pose


def test_a_robot_put_down_in_an_office_finds_itself(office: tuple[MapIndex, se2.Pose]) -> None:
    index, origin = office
    accepted = 0
    for slam, truth in pieces("office", seed=5, seconds=8.0, starts=[8.0, 20.0, 32.0, 44.0]):
        found = relocalise(submap_of(slam.slam_state.mapper), index)
        if found is None or not found.verdict.accepted:
            continue
        accepted += 1
        error = se2.between(se2.between(origin, truth), found.pose)
        assert np.hypot(*error[:2]) < 0.1
        assert abs(error[2]) < np.radians(1.5)
    assert accepted >= 3


@pytest.mark.parametrize("world", ["room", "columns", "corridor"])
def test_a_robot_in_another_building_is_not_believed(world: str, office: tuple[MapIndex, se2.Pose]) -> None:
    for slam, _ in pieces(world, seed=5, seconds=8.0, starts=[2.0, 12.0]):
        found = relocalise(submap_of(slam.slam_state.mapper), office[0])
        assert found is None or not found.verdict.accepted


def test_the_benchmark_counts_what_was_found(wclm: Callable[..., Result]) -> None:
    result = wclm("bench", "relocalisation", "sim:room?seed=3&duration=30", "--count", 2)
    assert result.exit_code == 0, result.output
    header, *rows = result.stdout.splitlines()
    assert header.split()[:4] == ["metres", "places", "accepted", "right"]
    assert [row.split()[:2] for row in rows] == [["2", "2"], ["4", "2"], ["6", "0"]]  # a half is shorter than 6 m
    for row in rows:
        _, places, accepted, right, _, known, found, *_ = row.split()
        assert int(places) >= int(accepted) >= int(right) >= int(found)
        assert int(known) >= int(found)
