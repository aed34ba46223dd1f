"""Relocalisation: the right pose is found from anywhere; ambiguous, undetermined and foreign places are rejected."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import Result

from drivers import se2
from drivers.messages import GroundTruth, Message
from drivers.simulation import LidarModel, Simulation
from slam.geometry.segments import Floats, Segments
from slam.loop_closure.map_descriptor import describe_map
from slam.loop_closure.relocalisation import MapIndex, Relocalisation, Submap, index_map, relocalise, submap_of
from slam.loop_closure.visibility import compare_visibility
from slam.loop_closure.wall_pairs import build_pair_table
from slam.mapping.landmarks import Landmarks
from slam.pipeline import Slam

ROUGHNESS = 1e-6
LIDAR = LidarModel(beams=460)


def room(x: float, y: float, width: float, depth: float, niche: float) -> Floats:
    """Return the walls (6, 4) of a room with a niche at its upper left: frames seen from inside, and half lengths."""
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
    """Return landmarks with confirmed walls (n, 4), known to a centimetre and a tenth of a degree."""
    landmarks = Landmarks()
    for wall in walls:
        identity = landmarks.add_wall(wall[:3], wall[3], 0)
        landmarks.walls.rows["in_graph"][identity] = True
        landmarks.walls.rows["covariance"][identity] = np.diag([0.01, 0.002]) ** 2
    return landmarks


def index_of(walls: Floats) -> MapIndex:
    descriptor = describe_map(landmarks_of(walls), ROUGHNESS)
    return MapIndex(descriptor, build_pair_table(descriptor))


def submap_at(pose: se2.Pose, walls: Floats, own: se2.Pose) -> Submap:
    """Return a submap of walls of the map as seen from `pose`, in a frame in which that pose is `own`."""
    there = se2.compose(own, se2.inverse(pose))
    moved = np.column_stack([se2.compose(there, walls[:, :3]), walls[:, 3]])
    covariances = np.tile(np.eye(2) * 1e-4, (len(walls), 1, 1))
    segments = Segments(se2.between(own, moved[:, :3]), walls[:, 3].copy(), covariances)
    return Submap(describe_map(landmarks_of(moved), ROUGHNESS), own, [(own, segments)])


@pytest.mark.parametrize("k", range(len(ROOMS)))
def test_room_is_found_among_others(k: int) -> None:
    own = np.array([0.3, -0.2, 2.0])
    found = relocalise(submap_at(INSIDE[k], ROOMS[k], own), index_of(np.concatenate(ROOMS)))
    assert found is not None
    assert found.verdict.accepted, found.verdict.reason
    np.testing.assert_allclose(se2.between(INSIDE[k], found.pose), 0.0, atol=1e-3)
    np.testing.assert_allclose(se2.compose(found.motion, own), found.pose, atol=1e-9)
    assert found.verdict.matches == 6
    assert (np.linalg.eigvalsh(found.covariance) > 0.0).all()


coordinate = st.floats(-200.0, 200.0)


@settings(max_examples=10, deadline=None)
@given(st.tuples(coordinate, coordinate, st.floats(-np.pi, np.pi)))
def test_result_does_not_depend_on_the_submaps_frame(own: tuple[float, float, float]) -> None:
    """The pose in the map is the same in any frame of the submap; the motion compensates for the frame."""
    index = index_of(np.concatenate(ROOMS))
    at_origin = relocalise(submap_at(INSIDE[2], ROOMS[2], np.zeros(3)), index)
    moved = relocalise(submap_at(INSIDE[2], ROOMS[2], np.array(own)), index)
    assert at_origin is not None
    assert moved is not None
    np.testing.assert_allclose(se2.between(at_origin.pose, moved.pose), 0.0, atol=1e-6)
    np.testing.assert_allclose(at_origin.covariance, moved.covariance, rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(se2.between(moved.motion, se2.compose(moved.pose, se2.inverse(own))), 0.0, atol=1e-6)
    assert moved.verdict.accepted == at_origin.verdict.accepted


def assert_rejected(found: Relocalisation | None, because: str) -> None:
    assert found is not None
    assert not found.verdict.accepted
    assert because in found.verdict.reason


def test_room_with_fourfold_symmetry_is_ambiguous() -> None:
    walls = np.concatenate([SQUARE, BOX])
    assert_rejected(
        relocalise(submap_at(np.array([1.0, 1.5, 0.0]), walls, np.zeros(3)), index_of(walls)), "an alternative"
    )


def test_four_walls_are_not_enough_evidence() -> None:
    """Any four walls match four walls of most buildings."""
    walls = np.concatenate(ROOMS)
    assert_rejected(
        relocalise(submap_at(INSIDE[0], ROOMS[0][[0, 1, 2, 5]], np.zeros(3)), index_of(walls)), "not enough evidence"
    )


def test_one_of_two_equal_rooms_is_ambiguous() -> None:
    twin = ROOMS[1] + np.array([50.0, 20.0, 0.0, 0.0])
    walls = np.concatenate([*ROOMS, twin])
    assert_rejected(relocalise(submap_at(INSIDE[1], ROOMS[1], np.zeros(3)), index_of(walls)), "an alternative")


def test_twin_room_with_moved_furniture_is_ambiguous() -> None:
    """The views distinguish the rooms, but the furniture may have been moved back."""
    away = np.array([50.0, 20.0, 0.0, 0.0])
    screens = np.array([[INSIDE[1][0] + 0.4, 1.5, -np.pi / 2, 1.4], [INSIDE[1][0] - 0.4, 1.5, np.pi / 2, 1.4]])
    index = index_of(np.concatenate([*ROOMS, ROOMS[1] + away, screens + away]))
    found = relocalise(submap_at(INSIDE[1], ROOMS[1], np.zeros(3)), index)
    assert_rejected(found, "an alternative matches")
    assert found is not None
    assert found.verdict.runner_up < 0.6 * found.verdict.score


def test_parallel_walls_alone_give_no_candidates() -> None:
    corridor = np.array([[x, y, h, 4.0] for x in (-4.0, 4.0, 12.0) for y, h in ((0.0, 0.0), (2.0, np.pi))])
    assert relocalise(submap_at(np.array([1.0, 1.0, 0.0]), corridor, np.zeros(3)), index_of(corridor)) is None


def test_position_along_corridor_is_not_accepted_if_undetermined() -> None:
    """The corridor's end is in the map, but the submap has only its sides and a cabinet that is not in the map."""
    sides = np.array([[5.0, 0.0, 0.0, 5.0], [5.0, 2.0, np.pi, 5.0]])
    end = np.array([[10.0, 1.0, np.pi / 2, 1.0]])
    cabinet = np.array([[4.0, 0.4, np.pi / 2, 0.4]])
    found = relocalise(
        submap_at(np.array([3.0, 1.0, 0.0]), np.concatenate([sides, cabinet]), np.zeros(3)),
        index_of(np.concatenate([sides, end])),
    )
    assert_rejected(found, "standard deviations")


def test_equal_doors_along_a_corridor_are_ambiguous() -> None:
    jambs = [[x, y, np.pi / 2, 0.3] for x in np.arange(0.0, 40.0, 2.0) for y in (0.0, 2.0)]
    walls = np.array([*jambs, [20.0, -0.3, 0.0, 20.0], [20.0, 2.3, np.pi, 20.0]])
    near = np.array(
        [*[jamb for jamb in jambs if 14.0 < jamb[0] < 23.0], [18.0, -0.3, 0.0, 4.0], [18.0, 2.3, np.pi, 4.0]]
    )
    assert_rejected(
        relocalise(submap_at(np.array([18.0, 1.0, 0.0]), near, np.zeros(3)), index_of(walls)), "an alternative"
    )


def test_segments_seen_through_walls_of_the_map_contradict_a_pose() -> None:
    """The map has a partition in the room, which hides one side from the other."""
    partition = np.array([[3.5, 1.5, np.pi / 2, 1.2]])
    index = index_of(np.concatenate([*ROOMS, partition]))
    found = relocalise(submap_at(np.array([1.5, 1.5, 0.0]), ROOMS[0], np.zeros(3)), index)
    assert_rejected(found, "through walls of the map")


def test_rays_agree_at_the_true_pose_and_contradict_a_wrong_one() -> None:
    descriptor = index_of(SQUARE).descriptor
    pose = np.array([2.0, 2.0, 0.7])
    views = submap_at(pose, SQUARE, np.zeros(3)).views
    there = compare_visibility(pose, views, descriptor)
    assert there.agreement == 1.0
    assert there.contradicted == 0.0
    assert there.agreeing > 100
    beyond = compare_visibility(pose + np.array([2.5, 0.0, 0.0]), views, descriptor)
    assert beyond.contradicted > 0.1


def test_submap_or_map_with_too_few_walls_gives_no_result() -> None:
    index = index_of(np.concatenate(ROOMS))
    assert relocalise(submap_at(INSIDE[0], ROOMS[0][:2], np.zeros(3)), index) is None
    assert relocalise(submap_at(INSIDE[0], ROOMS[0], np.zeros(3)), index_of(ROOMS[0][:0])) is None


# --- with simulated drives


def mapped(messages: list[Message]) -> Slam:
    slam = Slam()
    for message in messages:
        slam.add(message)
    return slam


def map_parts(world: str, seed: int, seconds: float, starts: list[float]) -> Iterator[tuple[Slam, se2.Pose]]:
    """Map parts of a drive, each on its own; yield the map and the true pose at its last keyframe."""
    messages = list(Simulation(world, seed=seed, duration=max(starts) + seconds + 1.0, lidar=LIDAR))
    for start in starts:
        part = [message for message in messages if start <= message.stamp < start + seconds]
        slam = mapped(part)
        truth = [message for message in part if isinstance(message, GroundTruth)]
        at = slam.finish().keyframe_stamps[-1]
        yield slam, min(truth, key=lambda message: abs(message.stamp - at)).pose


@pytest.fixture(scope="module")
def office() -> tuple[MapIndex, se2.Pose]:
    """Return the map of a drive through an office, and the drive's first pose in the world."""
    messages = list(Simulation("office", seed=2, duration=60.0, lidar=LIDAR))
    first = next(message for message in messages if isinstance(message, GroundTruth))
    slam = mapped(messages)
    slam.finish()
    return index_map(slam.slam_state.mapper), first.pose


def test_robot_is_relocalised_in_office(office: tuple[MapIndex, se2.Pose]) -> None:
    index, origin = office
    accepted = 0
    for slam, truth in map_parts("office", seed=5, seconds=8.0, starts=[8.0, 20.0, 32.0, 44.0]):
        found = relocalise(submap_of(slam.slam_state.mapper), index)
        if found is None or not found.verdict.accepted:
            continue
        accepted += 1
        error = se2.between(se2.between(origin, truth), found.pose)
        assert np.hypot(*error[:2]) < 0.1
        assert abs(error[2]) < np.radians(1.5)
    assert accepted == 4


@pytest.mark.parametrize("world", ["room", "columns", "corridor"])
def test_pose_in_another_building_is_rejected(world: str, office: tuple[MapIndex, se2.Pose]) -> None:
    for slam, _ in map_parts(world, seed=5, seconds=8.0, starts=[2.0, 12.0]):
        found = relocalise(submap_of(slam.slam_state.mapper), office[0])
        assert found is None or not found.verdict.accepted


def test_benchmark_counts_accepted_poses(wclm: Callable[..., Result]) -> None:
    result = wclm("bench", "relocalisation", "sim:room?seed=3&duration=30", "--count", 2)
    assert result.exit_code == 0, result.output
    header, *rows = result.stdout.splitlines()
    assert header.split()[:4] == ["metres", "places", "accepted", "right"]
    assert [row.split()[:2] for row in rows] == [["2", "2"], ["4", "2"], ["6", "0"]]  # a half is shorter than 6 m
    for row in rows:
        _, places, accepted, right, _, known, found, *_ = row.split()
        assert int(places) >= int(accepted) >= int(right) >= int(found)
        assert int(known) >= int(found)
