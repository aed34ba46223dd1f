"""Search in a map from any start: the right pose is among the candidates, with most wall length on the map's walls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import Result

from drivers import se2
from slam.geometry.roughness import Roughness
from slam.geometry.segments import Floats
from slam.mapping.landmarks import Landmarks
from slam.recognition.map_descriptor import MapDescriptor, describe_map, express_in_frame
from slam.recognition.map_index import MapIndex, align_candidates
from slam.recognition.wall_pairs import build_pair_table, vote_for_poses

ROUGHNESS = Roughness(1e-6, 1e-6)


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


def seen_from(pose: se2.Pose, walls: Floats) -> MapDescriptor:
    """Return walls of a map as a submap in the frame of a pose."""
    return express_in_frame(pose, describe_map(landmarks_of(walls), ROUGHNESS))


@pytest.mark.parametrize("k", range(len(ROOMS)))
def test_room_is_found_among_others(k: int) -> None:
    best, *others = align_candidates(seen_from(INSIDE[k], ROOMS[k]), index_of(np.concatenate(ROOMS)))
    np.testing.assert_allclose(se2.between(INSIDE[k], best.pose), 0.0, atol=1e-3)
    assert (best.matches >= 0).all()
    assert best.length > 0.9 * best.observed.sum()
    assert (np.linalg.eigvalsh(best.information) > 0.0).all()
    assert all(other.length < best.length for other in others)


coordinate = st.floats(-200.0, 200.0)


@settings(max_examples=10, deadline=None)
@given(st.tuples(coordinate, coordinate, st.floats(-np.pi, np.pi)))
def test_result_does_not_depend_on_the_maps_frame(frame: tuple[float, float, float]) -> None:
    there, walls = np.array(frame), np.concatenate(ROOMS)
    moved = np.column_stack([se2.compose(there, walls[:, :3]), walls[:, 3]])
    observed = seen_from(INSIDE[2], ROOMS[2])
    best, elsewhere = align_candidates(observed, index_of(walls))[0], align_candidates(observed, index_of(moved))[0]
    np.testing.assert_allclose(se2.between(se2.compose(there, best.pose), elsewhere.pose), 0.0, atol=1e-6)
    assert elsewhere.length == pytest.approx(best.length)


def test_every_equal_place_is_a_candidate() -> None:
    """A square room with a square box looks the same from four poses, and two equal rooms from two."""
    square = np.concatenate([SQUARE, BOX])
    twins = np.concatenate([*ROOMS, ROOMS[1] + np.array([50.0, 20.0, 0.0, 0.0])])
    for observed, walls, places in ((square, square, 4), (ROOMS[1], twins, 2)):
        found = align_candidates(seen_from(INSIDE[1], observed), index_of(walls))
        assert sum(one.length == pytest.approx(found[0].length, rel=0.01) for one in found) == places


@pytest.mark.parametrize("gap", [0.5, 0.55, 0.6, 0.65, 0.7])
def test_room_is_found_with_new_furniture_in_rows_in_front_of_a_wall(gap: float) -> None:
    """Poses at which the furniture is taken for the wall get few votes each, and are beside that of the room."""
    rows = [[gap * k, 1.0, -np.pi / 2, 0.8] for k in (1, 2)]
    first, *_ = vote_for_poses(seen_from(INSIDE[0], ROOMS[0]), index_of(np.array([*ROOMS[0], *rows])).pairs, 64)
    np.testing.assert_allclose(se2.between(INSIDE[0], first)[:2], 0.0, atol=0.1)


def test_parallel_walls_alone_give_no_candidates() -> None:
    corridor = np.array([[x, y, h, 4.0] for x in (-4.0, 4.0, 12.0) for y, h in ((0.0, 0.0), (2.0, np.pi))])
    assert not align_candidates(seen_from(np.array([1.0, 1.0, 0.0]), corridor), index_of(corridor))


def test_submap_or_map_with_too_few_walls_gives_no_candidates() -> None:
    walls = np.concatenate(ROOMS)
    assert not align_candidates(seen_from(INSIDE[0], ROOMS[0][:2]), index_of(walls))
    assert not align_candidates(seen_from(INSIDE[0], ROOMS[0]), index_of(walls[:0]))


@pytest.mark.slow
def test_benchmark_counts_accepted_poses(wclm: Callable[..., Result]) -> None:
    result = wclm("bench", "relocalisation", "sim:room?seed=3&duration=25&lidar=short", "--count", 2)
    assert result.exit_code == 0, result.output
    header, *rows = result.stdout.splitlines()
    assert header.split()[:4] == ["metres", "places", "accepted", "right"]
    assert [row.split()[:2] for row in rows] == [["2", "2"], ["4", "2"], ["6", "0"]]  # a half is shorter than 6 m
    for row in rows:
        _, places, accepted, right, _, known, found, *_ = row.split()
        assert int(places) >= int(accepted) >= int(right) >= int(found)
        assert int(known) >= int(found)
