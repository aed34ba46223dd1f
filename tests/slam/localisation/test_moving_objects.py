"""Objects that have moved, such as people who walk with the robot, against odometry that has failed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers import se2
from drivers.simulation import LidarModel, Simulation, load_world
from slam import Slam
from slam.evaluation.benchmarks.scenarios.world_variants import add_crowd
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.match_target import MatchTarget, ScanMatch
from slam.localisation.moving_objects import match_without_moving, without_points
from slam.mapping.local_map import empty_local_map
from slam.matching.point_matcher import Prediction
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints

from ..outlines import noisy_field, outline, visible, with_noise

RANGE, WIDTH = 6.0, 2.0  # metres
CORRIDOR = outline([(-20, -0.5 * WIDTH), (20, -0.5 * WIDTH), (20, 0.5 * WIDTH), (-20, 0.5 * WIDTH)])
DRIVEN = np.array([0.4, 0.0, 0.0])  # from the first scan to the second one
STANDING = np.zeros(3)
COLUMNS = (1.5, 0.6), (2.5, -0.7), (-1.2, 0.7), (3.2, 0.5)
PERSON = (1.0, 0.5)
SIDES = Segments(
    np.array([[0.0, -0.5 * WIDTH, 0.0], [0.0, 0.5 * WIDTH, np.pi]]),
    np.full(2, 5.0),
    np.tile(4e-6 * np.eye(2), (2, 1, 1)),
)


def circle(x: float, y: float) -> Floats:
    """Return points (n, 2) on the outline of a person or a column."""
    angles = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    return np.array([x, y]) + 0.2 * np.column_stack([np.cos(angles), np.sin(angles)])


def in_range(points: Floats, pose: Floats) -> Floats:
    return points[np.hypot(*(points - pose[:2]).T) < RANGE]


def matched(before: Floats, now: Floats, pose: Floats) -> tuple[ScanMatch, ScanMatch | None]:
    """Return the match of a scan from `pose`, and the one without objects that have moved.

    before, now  (n, 2), (m, 2) surfaces at a scan from the origin, which is in the field, and at the scan from `pose`

    Odometry says that the robot has driven; the other prediction is that it may be anywhere within some decimetres.
    """
    field = noisy_field(in_range(before, STANDING), STANDING)
    seen = with_noise(visible(in_range(now, pose), pose), np.random.default_rng(3))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
    scan = ScanFeatures(SIDES, corners, ScanPoints(seen))
    odometry = Prediction(DRIVEN, np.diag(np.array([0.03, 0.02, 0.01]) ** -2.0))
    slip = Prediction(STANDING, np.diag(np.array([0.3, 0.1, 0.05]) ** -2.0), cost=3.0)
    target = MatchTarget(empty_local_map(), field, 0.0)
    match = target.match(scan, [odometry, slip])
    return match, match_without_moving(match, [odometry, slip], scan, target)


def corridor_with(*objects: Floats) -> Floats:
    return np.concatenate([CORRIDOR, *objects])


def test_person_who_walks_with_the_robot_does_not_stop_it() -> None:
    walked = circle(PERSON[0] + DRIVEN[0], PERSON[1])
    match, static = matched(corridor_with(circle(*PERSON)), corridor_with(walked), DRIVEN)
    assert abs(match.points.pose[0]) < 0.1  # the whole scan fits best where the robot has not driven
    assert static is not None
    assert np.abs(static.points.pose - DRIVEN).max() < 0.03


def test_wheels_that_spin_among_columns_are_recognised() -> None:
    columns = [circle(*column) for column in COLUMNS]
    match, static = matched(corridor_with(*columns), corridor_with(*columns), STANDING)
    assert np.abs(match.points.pose - STANDING).max() < 0.03
    assert static is None


def test_match_that_agrees_with_odometry_is_kept() -> None:
    columns = [circle(*column) for column in COLUMNS]
    match, static = matched(corridor_with(*columns), corridor_with(*columns), DRIVEN)
    assert np.abs(match.points.pose - DRIVEN).max() < 0.03
    assert static is None


def test_segments_and_corners_of_removed_points_are_removed() -> None:
    sides = np.concatenate([np.column_stack([np.linspace(-4, 4, 80), np.full(80, y)]) for y in (-1.0, 1.0)])
    corners = CornerPoints(
        np.array([[4.0, 0.0], [5.0, 1.0]]),
        np.tile(1e-4 * np.eye(2), (2, 1, 1)),
        np.array([[0, 1], [1, 1]]),
        np.zeros((2, 2)),
    )
    scan = ScanFeatures(SIDES, corners, ScanPoints(sides))
    rest = without_points(scan, sides[:, 1] < 0.0)
    assert np.array_equal(rest.segments.frame, SIDES.frame[1:])
    assert np.array_equal(rest.corners.position, [[5.0, 1.0]])
    assert np.array_equal(rest.corners.segments, [[0, 0]])
    assert np.array_equal(rest.points.xy, scan.points.xy[80:])


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
