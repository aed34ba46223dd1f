"""Small objects count in a match by as much as it is rare that one moves: people little, columns fully."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers import se2
from drivers.simulation import LidarModel, Simulation, load_world
from slam import Slam
from slam.evaluation.benchmarks.scenarios.world_variants import add_crowd
from slam.geometry.roughness import Roughness
from slam.geometry.segments import CornerPoints, Floats, Integers, Segments
from slam.localisation.match_target import MatchTarget
from slam.localisation.small_objects import MAX_OBJECTS, SmallObjects, objects_of
from slam.mapping.local_map import empty_local_map
from slam.matching.point_costs import MISFIT
from slam.matching.point_matcher import POINTS_PER_OBJECT, Prediction
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import WEIGHT, ScanPoints

from ..outlines import NO_SEGMENTS, noisy_field, outline, visible, with_noise

RANGE, WIDTH = 6.0, 2.0  # metres
SMOOTH = Roughness(0.0, 0.0)
CORRIDOR = outline([(-20, -0.5 * WIDTH), (20, -0.5 * WIDTH), (20, 0.5 * WIDTH), (-20, 0.5 * WIDTH)])
DRIVEN = np.array([0.4, 0.0, 0.0])  # from the first scan to the second one
STANDING = np.zeros(3)
COLUMNS = (1.5, 0.6), (2.5, -0.7), (-1.2, 0.7), (3.2, 0.5)
PERSON = (1.0, 0.5)
SIDES = Segments(
    np.array([[0.0, -0.5 * WIDTH, 0.0], [0.0, 0.5 * WIDTH, np.pi]]),
    np.full(2, RANGE),
    np.tile(4e-6 * np.eye(2), (2, 1, 1)),
)

NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))


def circle(x: float, y: float) -> Floats:
    """Return points (n, 2) on the outline of a person or a column."""
    angles = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    return np.array([x, y]) + 0.2 * np.column_stack([np.cos(angles), np.sin(angles)])


def in_range(points: Floats, pose: Floats) -> Floats:
    return points[np.hypot(*(points - pose[:2]).T) < RANGE]


def scan_from(pose: Floats, surfaces: Floats) -> ScanFeatures:
    """Return the scan of surfaces (n, 2) from `pose`, with the sides of the corridor as segments."""
    seen = with_noise(visible(in_range(surfaces, pose), pose), np.random.default_rng(3))
    return ScanFeatures(SIDES, NO_CORNERS, ScanPoints(seen))


def matched(before: Floats, now: Floats, pose: Floats, objects: SmallObjects) -> Floats:
    """Return the matched pose of a scan from `pose`.

    before, now  (n, 2), (m, 2) surfaces at a scan from the origin, which is in the field, and at the scan from `pose`

    Odometry says that the robot has driven; the other prediction is that it may be anywhere within some decimetres.
    """
    field = noisy_field(in_range(before, STANDING), STANDING)
    scan = scan_from(pose, now)
    odometry = Prediction(DRIVEN, np.diag(np.array([0.03, 0.02, 0.01]) ** -2.0))
    slip = Prediction(STANDING, np.diag(np.array([0.3, 0.1, 0.05]) ** -2.0), cost=3.0)
    target = MatchTarget(empty_local_map(), field, SMOOTH)
    return target.match(scan, [odometry, slip], objects.weighted_points(scan), earlier_evidence=0.0).points.pose


def corridor_with(*objects: Floats) -> Floats:
    return np.concatenate([CORRIDOR, *objects])


def with_share(moved: float) -> SmallObjects:
    """Return what is learned after many objects, a share of which has moved."""
    return SmallObjects(MAX_OBJECTS, moved * MAX_OBJECTS)


def test_person_who_walks_with_the_robot_does_not_stop_it() -> None:
    walked = circle(PERSON[0] + DRIVEN[0], PERSON[1])
    pose = matched(corridor_with(circle(*PERSON)), corridor_with(walked), DRIVEN, SmallObjects())
    assert np.abs(pose - DRIVEN).max() < 0.03


@pytest.mark.parametrize(("count", "moved"), [(2, 0.25), (4, 0.5)])
def test_people_do_not_stop_the_robot_where_many_objects_move(count: int, moved: float) -> None:
    before, walked = (
        corridor_with(*(circle(x + shift, y) for x, y in COLUMNS[:count])) for shift in (0.0, float(DRIVEN[0]))
    )
    assert np.abs(matched(before, walked, DRIVEN, with_share(moved)) - DRIVEN).max() < 0.05


@pytest.mark.parametrize(("count", "moved"), [(2, 0.0), (4, 0.1)])
def test_wheels_that_spin_among_columns_are_recognised_where_objects_stand(count: int, moved: float) -> None:
    surfaces = corridor_with(*(circle(*column) for column in COLUMNS[:count]))
    assert np.abs(matched(surfaces, surfaces, STANDING, with_share(moved)) - STANDING).max() < 0.03


def test_wheels_that_spin_among_columns_are_recognised_at_once() -> None:
    surfaces = corridor_with(*(circle(*column) for column in COLUMNS))
    assert np.abs(matched(surfaces, surfaces, STANDING, SmallObjects()) - STANDING).max() < 0.03


def test_a_scan_that_fits_everywhere_does_not_contradict_odometry() -> None:
    assert np.abs(matched(CORRIDOR, CORRIDOR, STANDING, SmallObjects()) - DRIVEN).max() < 0.03


def test_match_that_agrees_with_odometry_is_kept() -> None:
    surfaces = corridor_with(*(circle(*column) for column in COLUMNS))
    assert np.abs(matched(surfaces, surfaces, DRIVEN, SmallObjects()) - DRIVEN).max() < 0.03


@pytest.mark.parametrize("moved", [0.0, 0.5, 1.0])
def test_the_share_of_objects_that_have_moved_is_learned(moved: float) -> None:
    places = [(-3.0, 0.5), (-1.5, -0.5), (1.5, 0.5), (3.0, -0.5)]
    stay = round((1.0 - moved) * len(places))
    later = [(x if k < stay else 0.7 * x, y) for k, (x, y) in enumerate(places)]  # nearer, where nothing was
    field = noisy_field(in_range(corridor_with(*(circle(*at) for at in places)), STANDING), STANDING)
    scan, objects = scan_from(STANDING, corridor_with(*(circle(*at) for at in later))), SmallObjects()
    for _ in range(200):
        objects.add(scan, STANDING, field, 0.1)
    assert objects.seen == pytest.approx(MAX_OBJECTS)
    assert math.exp(-objects.moved_cost) == pytest.approx(moved, abs=0.1)


def objects_in(points: Floats) -> Integers:
    """Return the numbers of the objects on which points (n, 2) without walls lie, seen from the origin."""
    return objects_of(ScanFeatures(NO_SEGMENTS, NO_CORNERS, ScanPoints(points)))


def side(start: tuple[float, float], end: tuple[float, float]) -> Floats:
    return np.linspace(start, end, int(np.hypot(*np.subtract(end, start)) / 0.06) + 1)


def test_only_what_stands_free_is_an_object() -> None:
    """Beams go from right to left, over a post 2 m ahead and a wall behind it."""
    post, wall = side((2.0, -0.2), (2.0, 0.2)), side((4.0, -2.0), (4.0, -0.6))
    rest = side((4.0, 0.6), (4.0, 2.0))
    assert (objects_in(np.concatenate([wall, post, rest])) >= 0).sum() == len(post)
    assert np.all(objects_in(post) == 0)  # alone
    beside_wall = np.concatenate([side((2.0, -2.0), (2.0, -0.25)), post, rest])
    assert np.all(objects_in(beside_wall) == -1)


def test_the_piece_of_a_wall_that_a_nearer_edge_hides_is_no_object() -> None:
    """Through a door, some decimetres of a wall are seen between its nearer frames."""
    seen = side((4.0, -0.3), (4.0, 0.3))
    frames = side((2.0, -2.0), (2.0, -0.2)), side((2.0, 0.2), (2.0, 2.0))
    assert np.all(objects_in(np.concatenate([frames[0], seen, frames[1]])) == -1)


def test_an_object_costs_as_much_as_it_is_rare_that_one_moves() -> None:
    scan = scan_from(STANDING, corridor_with(circle(*PERSON)))
    for moved in (0.02, 0.2, 0.8):
        objects = with_share(moved)
        weights = objects.weighted_points(scan)[:, WEIGHT]
        on_person = objects_of(scan) >= 0
        assert on_person.sum() >= POINTS_PER_OBJECT
        cost = weights[on_person].sum() * MISFIT / POINTS_PER_OBJECT
        assert cost == pytest.approx(min(objects.moved_cost, on_person.sum() * MISFIT / POINTS_PER_OBJECT))
        assert np.all(weights[~on_person] == 1.0)


@pytest.mark.slow
def test_odometry_does_not_count_as_failing_beside_people_who_walk_with_the_robot() -> None:
    """Without odometry, the robot would stand beside people who keep their distance, in a corridor without doors."""
    assert _error_beside_people(8) < 0.1


@pytest.mark.slow
def test_people_who_walk_with_the_robot_do_not_shorten_a_corridor() -> None:
    """The end of the path is as far away as odometry says, which errs by 1 to 2 % of the distance driven.

    People shorten single drives: in a bare corridor they are all that seems to show how far the robot has driven.
    """
    errors = [_error_beside_people(seed) for seed in range(1, 7)]
    assert np.mean(errors) < 0.03
    assert np.median(errors) < 0.02


def _error_beside_people(seed: int) -> float:
    """Return the error of the last position of a drive along a bare corridor, as a share of the distance driven."""
    duration = 40.0
    world = add_crowd(load_world("bare_corridor"), 3, np.random.default_rng(seed), duration)
    lidar = LidarModel(beams=500, rate=8.0, field_of_view=math.radians(270.0), range_max=7.0, sigma_range=0.02)
    drive, slam = Simulation(world, seed, duration, lidar), Slam()
    for message in drive:
        slam.add(message)
    finished = slam.finish()
    true = drive.trajectory.poses_at(finished.stamps)
    error = se2.between(true[0], true[-1]) - se2.between(finished.poses[0], finished.poses[-1])
    return float(np.hypot(*error[:2]) / np.hypot(*np.diff(true[:, :2], axis=0).T).sum())
