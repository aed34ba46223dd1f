"""What rays from places in a plan meet: the nearest line of many, and no more places than a run has room for."""

import math

import numpy as np
import pytest

from slam.errors import MapError
from slam.mapping.plan import Plan
from slam.mapping.plan_map import VIEW_NOISE, build_plan_map
from slam.mapping.plan_views import cast_views, find_viewpoints
from slam.mapping.ray_casting import SegmentIndex, cast_rays, mark_near, tour

REACH = 20.0
BEARING = 2.0 * math.pi * (np.arange(90) + 0.5) / 90
DIRECTIONS = np.column_stack([np.cos(BEARING), np.sin(BEARING)])


def scattered(seed: int, count: int = 400, extent: float = 60.0) -> np.ndarray:
    """Return short and long segments (n, 2, 2) in all directions, some of them along an axis, one a point."""
    random = np.random.default_rng(seed)
    start, heading = random.uniform(0.0, extent, (count, 2)), random.uniform(-math.pi, math.pi, count)
    heading[::3] = np.round(heading[::3] / (0.5 * math.pi)) * 0.5 * math.pi
    length = random.uniform(0.05, 3.0, count)
    length[::50], length[7] = extent, 0.0
    along = length[:, None] * np.round(np.column_stack([np.cos(heading), np.sin(heading)]), 12)
    return np.stack([start, start + along], axis=1)


def nearest(place: np.ndarray, direction: np.ndarray, segments: np.ndarray) -> tuple[float, int]:
    """Return the distance and the row of the nearest segment on a ray, without an index."""
    start, along = segments[:, 0] - place, segments[:, 1] - segments[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = direction[0] * along[:, 1] - direction[1] * along[:, 0]
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / across
        share = (start[:, 0] * direction[1] - start[:, 1] * direction[0]) / across
        met = (distance > 0.0) & (distance < REACH) & (share >= 0.0) & (share <= 1.0)
    distance = np.where(met, distance, np.inf)
    row = int(distance.argmin())
    return float(distance[row]), row if met[row] else -1


@pytest.mark.parametrize("seed", range(3))
def test_a_ray_ends_at_the_nearest_segment(seed: int) -> None:
    segments = scattered(seed)
    places = np.random.default_rng(seed + 100).uniform(-5.0, 65.0, (40, 2))
    hits = cast_rays(SegmentIndex.of(segments), np.zeros(len(segments), bool), 0.0, places, DIRECTIONS, REACH, 0)
    for k, place in enumerate(places):
        expected = [nearest(place, direction, segments) for direction in DIRECTIONS]
        np.testing.assert_array_equal(hits.row[k], [row for _, row in expected])
        np.testing.assert_array_equal(hits.distance[k], [distance for distance, _ in expected])
        assert hits.visible[k] == (hits.row[k] >= 0).sum()


def test_a_segment_that_is_seen_from_the_other_side_only_hides_but_is_not_visible() -> None:
    walls = np.array([[[2.0, -1.0], [2.0, 1.0]]])  # its left side faces the place
    for segments, visible in ((walls, 1), (walls[:, ::-1], 0)):
        index, east = SegmentIndex.of(segments), np.array([[1.0, 0.0]])
        hits = cast_rays(index, np.array([True]), 0.0, np.zeros((1, 2)), east, REACH, 0)
        assert (hits.row[0, 0], hits.distance[0, 0], hits.visible[0]) == (0, 2.0, visible)


def test_places_near_segments_are_those_within_the_distance() -> None:
    segments = scattered(5, count=60)
    marks = mark_near(segments, np.array([-3.0, -2.0]), 1.5, (45, 44), 2.2)
    for i, j in np.ndindex(marks.shape):
        place = np.array([-3.0 + 1.5 * i, -2.0 + 1.5 * j])
        start, along = segments[:, 0] - place, segments[:, 1] - segments[:, 0]
        share = np.clip(-(start * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
        assert marks[i, j] == (np.hypot(*(start + share[:, None] * along).T).min() < 2.2)


def test_a_tour_visits_each_place_once_and_the_nearest_one_next() -> None:
    places = np.random.default_rng(1).uniform(0.0, 10.0, (30, 2))
    order = tour(places).tolist()
    assert sorted(order) == list(range(30))
    assert order[0] == 0
    for k in range(1, 30):
        distance = np.hypot(*(places - places[order[k - 1]]).T)
        assert distance[order[k]] == distance[order[k:]].min()
    assert not len(tour(np.zeros((0, 2))))


def rooms(columns: int, rows: int, side: float = 5.0) -> Plan:
    """Return a plan of square rooms beside each other."""
    lines = [[[side * i, 0.0], [side * i, side * rows]] for i in range(columns + 1)]
    lines += [[[0.0, side * j], [side * columns, side * j]] for j in range(rows + 1)]
    return Plan("plan", np.array(lines), np.zeros(len(lines), dtype=bool), 1e-3)


def test_a_large_plan_has_the_views_of_its_rooms() -> None:
    one, many = build_plan_map(rooms(1, 1), (0.03, 0.005)), build_plan_map(rooms(12, 10), (0.03, 0.005))
    assert len(one.walls) == 4  # two sides of each, of which one is seen from inside
    assert len(many.walls) == 2 * (11 + 9) + 4
    assert len(many.views) >= 120 * 4
    for view in many.views[::100]:
        room = np.floor(view.position / 5.0) * 5.0 - view.position
        noise = 5.0 * VIEW_NOISE
        assert (view.points >= room - noise).all()
        assert (view.points <= room + 5.0 + noise).all()


def test_places_far_from_all_lines_are_not_considered() -> None:
    lines = np.array([[[0.0, 0.0], [4.0, 0.0]], [[900.0, 900.0], [904.0, 900.0]]])
    apart = Plan("plan", lines, np.zeros(2, dtype=bool), 1e-3)
    assert len(find_viewpoints(apart)) < 2000  # of 360000 on the grid
    assert not cast_views(apart)


def test_a_plan_with_too_much_free_space_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = rooms(4, 4)
    count = len(cast_views(plan))
    monkeypatch.setattr("slam.mapping.plan_views.MAX_VIEWS", count)
    assert len(cast_views(plan)) == count
    monkeypatch.setattr("slam.mapping.plan_views.MAX_VIEWS", count - 1)
    with pytest.raises(MapError, match=r"plan: has room for more than \d+ views in 20 m x 20 m; .*--plan-unit"):
        cast_views(plan)
