"""Matching of all points of a scan: near and far predictions, open directions, unknown objects and unseen space."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import se2
from slam.geometry.segments import Floats, Segments
from slam.matching.distance_field import DistanceField
from slam.matching.offset_tiles import FIELD_CELL
from slam.matching.point_costs import UNSEEN, crossing_beams
from slam.matching.point_matcher import (
    POINT_SPACING,
    POINTS_PER_OBJECT,
    Prediction,
    match_points,
    point_cost,
    point_information,
)
from slam.matching.scan_points import FINE_SIGMA, WEIGHT, surface_points

from ..outlines import noisy_field, outline, scan_points

ROOM = outline([(0, 0), (5, 0), (5, 2), (3.5, 2), (3.5, 4), (0, 4)])  # angular, without symmetry
INSIDE = np.array([1.5, 1.5, 0.4])
CORRIDOR_HALF = 10.0  # metres
SEEDS = st.integers(0, 2**32 - 1)


def information(position: float, heading: float) -> Floats:
    """Return the information (3, 3) of a prediction with these standard deviations (metres, degrees)."""
    return np.diag(np.array([position, position, np.radians(heading)]) ** -2.0)


def assert_close(found: Floats, truth: Floats, metres: float, degrees: float) -> None:
    x, y, turn = se2.between(truth, found)
    assert np.hypot(x, y) < metres
    assert abs(turn) < np.radians(degrees)


def corridor_segments(pose: Floats, ends: tuple[float, float]) -> Segments:
    """Return the segments, seen from a pose, of the walls y = -1 and 1 and of a partition at x = 0 to 0.1.

    The partition consists of two parts, between the distances `ends` from the middle of the corridor.
    """
    x, heading = (0.0, 0.5 * np.pi) if pose[0] < 0.0 else (0.1, -0.5 * np.pi)
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    frames = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, np.pi], [x, -middle, heading], [x, middle, heading]])
    return Segments(se2.between(pose, frames), np.array([6.0, 6.0, half, half]), np.zeros((4, 2, 2)))


ROOM_FIELD = noisy_field(ROOM, INSIDE, seed=1)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.floats(0, 0.3), st.floats(-np.pi, np.pi), st.floats(-8, 8))
def test_pose_near_the_prediction_is_found_up_to_a_cell(seed: int, distance: float, side: float, turn: float) -> None:
    random = np.random.default_rng(seed)
    truth = np.array([*random.uniform(0.5, 2.5, 2), random.uniform(-np.pi, np.pi)])
    start = se2.compose(truth, [distance * np.cos(side), distance * np.sin(side), np.radians(turn)])
    found = match_points(ROOM_FIELD, scan_points(ROOM, truth, seed), [Prediction(start, information(0.3, 8.0))])[0]
    assert_close(found.pose, truth, FIELD_CELL, 1.0)
    assert not found.poor
    assert -np.pi <= found.pose[2] <= np.pi


@settings(max_examples=20, deadline=None)
@given(st.floats(-np.pi, np.pi), st.sampled_from([-35.0, 35.0]), st.floats(-np.pi, np.pi))
def test_pose_far_from_an_uncertain_prediction_is_found_up_to_a_cell(side: float, turn: float, heading: float) -> None:
    truth = np.array([1.5, 1.8, heading])
    start = se2.compose(truth, [np.cos(side), np.sin(side), np.radians(turn)])
    found = match_points(ROOM_FIELD, scan_points(ROOM, truth), [Prediction(start, information(0.5, 20.0))])[0]
    assert_close(found.pose, truth, FIELD_CELL, 1.0)
    assert found.fit > 0.95


@pytest.mark.parametrize("heading", [0.0, 0.5 * np.pi, 1.0])
@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5, 0.75])
def test_pose_is_accurate_wherever_walls_lie_in_the_grid(shift: float, heading: float) -> None:
    room = ROOM + shift * FIELD_CELL
    field = noisy_field(room, INSIDE, np.array([2.5, 1.0, -1.0]))
    truth = np.array([1.7, 1.3, heading])
    prediction = Prediction(se2.compose(truth, [0.06, -0.05, 0.02]), information(0.2, 5.0))
    errors = np.array(
        [se2.between(truth, match_points(field, scan_points(room, truth, k), [prediction])[0].pose) for k in range(5)]
    )
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.006
    assert np.hypot(*errors[:, :2].mean(axis=0)) < 0.004
    assert np.abs(errors[:, 2]).max() < 0.003


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("opening", [0.0, 0.4])
def test_other_face_of_a_thin_wall_does_not_shift_the_pose(opening: float, side: float) -> None:
    walls = [outline([(-6, y), (6, y)]) for y in (-1.0, 1.0)]
    ends = (0.5 * opening, 1.0)
    partitions = [outline([(0, y * ends[0]), (0.1, y * ends[0]), (0.1, y), (0, y)]) for y in (-1.0, 1.0)]
    points = np.concatenate(walls + partitions)
    before, after = np.array([0.05 - 2.0 * side, 0.1, 0.2]), np.array([0.05 + 2.0 * side, -0.1, -0.4])
    field = DistanceField.empty(np.zeros(2), 8.0)
    field.insert(before, scan_points(points, before, 0, corridor_segments(before, ends)))
    scan = scan_points(points, after, 1, corridor_segments(after, ends))
    found = match_points(field, scan, [Prediction(after, information(0.05, 2.0))])[0]
    assert_close(found.pose, after, 0.005, 0.2)


def test_other_face_of_a_thin_wall_is_no_evidence() -> None:
    along = np.arange(-2.0, 2.0, 0.02)
    here, there = (np.column_stack([np.full(len(along), x), along]) for x in (0.0, 0.1))
    field = noisy_field(here, np.array([-2.0, 0.0, 0.0]))
    pose = np.array([2.0, 0.0, np.pi])
    beyond = scan_points(there, pose)
    cost, _, known = point_cost(field, beyond, pose)
    assert len(beyond) > 50
    assert known == 0
    assert cost == UNSEEN * len(beyond)
    assert point_cost(field, scan_points(here, np.array([-1.5, 0.0, 0.0])), np.array([-1.5, 0.0, 0.0]))[1] > 0.95


def test_likely_prediction_is_preferred_and_others_are_tried_if_it_fails() -> None:
    right = Prediction(INSIDE, information(0.05, 2.0), 7.0)
    wrong = Prediction(se2.compose(INSIDE, [1.5, 1.0, 1.2]), information(0.02, 1.0))
    points = scan_points(ROOM, INSIDE)
    found = match_points(ROOM_FIELD, points, [wrong, right])[0]
    assert found.prediction is right
    assert_close(found.pose, INSIDE, FIELD_CELL, 1.0)
    usual = Prediction(INSIDE, information(0.05, 2.0))
    assert match_points(ROOM_FIELD, points, [usual, right])[0].prediction is usual


def test_a_likely_prediction_does_not_prevail_if_all_walls_are_centimetres_off() -> None:
    certain = 1e8 * np.eye(3)  # the matches stay at the predictions
    off, right = Prediction(se2.compose(INSIDE, [-0.03, 0.0, 0.0]), certain), Prediction(INSIDE, certain, 2.0)
    assert match_points(ROOM_FIELD, scan_points(ROOM, INSIDE), [off, right])[0].prediction is right


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shift", [-0.25, 0.2])
def test_parallel_walls_leave_the_pose_along_them_to_the_prediction(shift: float, seed: int) -> None:
    truth = np.array([0.3, 0.2, 0.05])
    along = np.arange(-CORRIDOR_HALF, CORRIDOR_HALF, 0.02)
    walls = np.concatenate([np.column_stack([along, np.full(len(along), side)]) for side in (-1.0, 1.0)])
    field = noisy_field(walls, np.zeros(3), half_width=CORRIDOR_HALF + 2, seed=seed)
    frames = se2.between(truth, np.array([[0.0, -1.0, 0.0], [0.0, 1.0, np.pi]]))
    segments = Segments(frames, np.array([6.0, 6.0]), np.tile(1e-6 * np.eye(2), (2, 1, 1)))
    scan = scan_points(walls[np.abs(walls[:, 0]) < 6.0], truth, seed + 10, segments)
    start = truth + np.array([shift, -0.1, 0.05])
    found = match_points(field, scan, [Prediction(start, information(0.2, 5.0))])[0]
    assert found.pose[0] == pytest.approx(start[0], abs=0.03)
    assert found.pose[1] == pytest.approx(truth[1], abs=0.01)
    assert found.pose[2] == pytest.approx(truth[2], abs=0.003)
    c, s = np.cos(found.pose[2]), np.sin(found.pose[2])
    ahead, aside = np.array([c, -s, 0.0]), np.array([s, c, 0.0])
    assert ahead @ found.information @ ahead < 1e-4 * (aside @ found.information @ aside)


@pytest.mark.parametrize(
    ("middle", "radius"),
    [
        ((0.65, 3.0), 0.3),
        ((0.65, 3.0), 0.6),
        ((2.7, 3.2), 0.3),
        ((4.3, 1.0), 0.3),
        ((4.3, 1.0), 0.6),
        ((1.5, 0.5), 0.3),
    ],
)
def test_unknown_object_does_not_pull_the_pose_from_the_prediction(middle: tuple[float, float], radius: float) -> None:
    angles = np.arange(40) * (POINT_SPACING + 1e-6) / radius
    circle = np.array(middle) + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    points = scan_points(np.concatenate([ROOM, circle]), INSIDE)
    found = match_points(ROOM_FIELD, points, [Prediction(INSIDE, information(0.05, 2.0))])[0]
    assert_close(found.pose, INSIDE, 0.02, 0.5)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_points_in_unseen_space_are_no_evidence(heading: float) -> None:
    truth = np.array([1.5, 1.5, heading])
    prediction = Prediction(se2.compose(truth, [0.1, -0.1, 0.03]), information(0.2, 5.0))
    random = np.random.default_rng(1)
    beyond = np.column_stack([np.arange(7.0, 9.0, 0.06), random.uniform(-3.0, 6.0, 34)])
    points = scan_points(ROOM, truth)
    plain = match_points(ROOM_FIELD, points, [prediction])[0]
    through = np.column_stack(
        [se2.transform(se2.inverse(truth), beyond), np.zeros((len(beyond), 3)), np.ones(len(beyond))]
    )
    found = match_points(ROOM_FIELD, np.concatenate([points, through]), [prediction])[0]
    np.testing.assert_allclose(found.pose, plain.pose, atol=1e-9)
    np.testing.assert_allclose(found.information, plain.information, rtol=1e-6, atol=1e-3)
    assert (found.known, found.fit) == (plain.known, pytest.approx(plain.fit))
    assert found.cost == pytest.approx(plain.cost + len(beyond) * UNSEEN / POINTS_PER_OBJECT)


def test_excess_reduces_the_information_and_leaves_the_pose() -> None:
    points = scan_points(ROOM, INSIDE)
    points[:, 2:WEIGHT] = 0.0  # of surfaces that are not known
    prediction = Prediction(se2.compose(INSIDE, [0.05, -0.05, 0.02]), information(0.2, 5.0))
    whole = match_points(ROOM_FIELD, points, [prediction])[0]
    points[:, 4] = 0.75
    part = match_points(ROOM_FIELD, points, [prediction])[0]
    np.testing.assert_array_equal(part.pose, whole.pose)
    np.testing.assert_allclose(part.information, 0.25 * whole.information, rtol=1e-9, atol=1e-6)
    assert point_information(points)[0, 0] == pytest.approx(0.25 * len(points) / FINE_SIGMA**2)


@pytest.mark.parametrize("noise", [0.005, 0.01])
def test_a_round_room_does_not_show_the_turn(noise: float) -> None:
    """The normals of a noisy circle point past its centre, as if the turn about it could be seen."""
    angles, turns, positions = np.arange(0.0, 2.0 * np.pi, 0.01), [], []
    wall = np.column_stack([np.arange(-1.0, 1.0, 0.05), np.full(40, 5.0)])
    segment = Segments(np.array([[0.0, 5.0, np.pi]]), np.array([1.0]), np.zeros((1, 2, 2)))
    for seed in range(10):
        random = np.random.default_rng(seed)

        def scan(random: np.random.Generator = random) -> Floats:
            circle = 4.0 + noise * random.normal(size=len(angles))
            points = circle[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
            beside = wall + noise * np.array([0.0, 1.0]) * random.normal(size=(40, 1))
            kept = surface_points(np.concatenate([points, beside]), segment, POINT_SPACING)
            return kept[np.hypot(*kept[:, :2].T) < 4.5]

        field = DistanceField.empty(np.zeros(2), 6.0)
        field.insert(np.zeros(3), scan())
        found = match_points(field, scan(), [Prediction(np.zeros(3), information(0.05, 2.0))])[0]
        turns.append(found.information[2, 2])
        positions.append(found.information[0, 0])
    assert np.mean(turns) < 0.05**-2
    assert np.mean(positions) > 0.01**-2


@pytest.mark.parametrize("empty", ["field", "scan"])
def test_pose_without_evidence_is_the_prediction(empty: str) -> None:
    field = DistanceField.empty(np.zeros(2), 4.0) if empty == "field" else ROOM_FIELD
    points = scan_points(ROOM if empty == "field" else np.zeros((0, 2)), INSIDE)
    found = match_points(field, points, [Prediction(INSIDE, information(0.2, 5.0))])[0]
    np.testing.assert_allclose(found.pose, INSIDE, atol=1e-12)
    np.testing.assert_array_equal(found.information, 0.0)
    assert found.known == 0
    assert not found.poor


def test_weights_count_as_numbers_of_points() -> None:
    points, prediction = scan_points(ROOM, INSIDE), Prediction(INSIDE, information(0.2, 5.0))
    heavy, doubled = points.copy(), np.concatenate([points, points[::2]])
    heavy[::2, WEIGHT] = 2.0
    weighted, repeated = (match_points(ROOM_FIELD, some, [prediction])[0] for some in (heavy, doubled))
    np.testing.assert_allclose(weighted.pose, repeated.pose, atol=1e-9)
    np.testing.assert_allclose(weighted.information, repeated.information, rtol=1e-6, atol=1e-3)
    assert weighted.cost == pytest.approx(repeated.cost)
    np.testing.assert_allclose(point_information(heavy), point_information(doubled), rtol=1e-9)


def test_people_stop_beams_but_no_beam_passes_through_a_wall() -> None:
    points = scan_points(ROOM, INSIDE)
    behind_the_wall = se2.compose(np.array([-1.0, 0.0, 0.0]), INSIDE)
    assert crossing_beams(ROOM_FIELD.arrays, points, INSIDE) <= 0.02 * len(points)
    assert crossing_beams(ROOM_FIELD.arrays, points * [0.5, 0.5, 1.0, 1.0, 1.0, 1.0], INSIDE) == 0
    assert crossing_beams(ROOM_FIELD.arrays, points, behind_the_wall) > 0.2 * len(points)


def test_in_a_crowd_odometry_is_believed_rather_than_a_pose_behind_a_wall() -> None:
    """Stop two beams of three by people, and offer a pose outside of the room at which their points lie on a wall."""
    truth = np.array([0.6, 2.0, 0.0])
    points = scan_points(ROOM, truth)
    crowd = points.copy()
    crowd[np.arange(len(crowd)) % 3 != 0, :2] *= 0.5
    usual = Prediction(truth, information(0.02, 1.0))
    beyond = Prediction(np.array([-1.2, 2.0, 0.0]), information(0.5, 20.0), 3.0)
    found = match_points(ROOM_FIELD, crowd, [usual, beyond])[0]
    assert found.prediction is usual


def test_cost_is_lowest_at_the_true_pose() -> None:
    points = scan_points(ROOM, INSIDE)
    cost, fit, known = point_cost(ROOM_FIELD, points, INSIDE)
    assert fit > 0.95
    assert known == len(points)
    for off in ([0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.1], [1.0, 1.0, 1.0]):
        other, worse, _ = point_cost(ROOM_FIELD, points, se2.compose(INSIDE, off))
        assert other > cost
        assert worse < fit
