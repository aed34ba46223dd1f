"""`wclm bench measure`, `regular`, `diff` and `plan` count what they say they count."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.simulation import load_world_file
from drivers.simulation.world import Wall, build_world
from slam.evaluation.benchmarks.map_changes import CONDITIONS, DOORS, PairResult, changes_table, office, score
from slam.evaluation.benchmarks.measuring import MeasuredDrive, coverage, measure_drives
from slam.evaluation.benchmarks.plans import PlanDrive, displace_walls, plan_of, plans_table
from slam.evaluation.benchmarks.plans import score as score_plan
from slam.evaluation.benchmarks.regularity import regularity_table, skew_walls
from slam.evaluation.benchmarks.regularity import score as score_regular
from slam.mapping.map_features import MapWalls
from slam.measuring.measurement import Kind
from slam.offline.map_diff import Change, ChangeKind, MapDiff

from ..measuring.plans import around, moved, room, wall_map

WORLD = """\
path = [[1, 1], [4, 1], [4, 2.5]]
walls = [
    { from = [0, 0], to = [5, 0] }, { from = [5, 0], to = [5, 3.5] },
    { from = [5, 3.5], to = [0, 3.5] }, { from = [0, 3.5], to = [0, 0] },
]
"""


def test_coverage_is_the_share_within_the_interval_of_each_drive() -> None:
    drives = [MeasuredDrive({Kind.WIDTH: np.array([0.0, 1.0, 3.0, -2.5])}), MeasuredDrive({Kind.WIDTH: np.zeros(2)})]
    (row,) = coverage(drives)
    assert (row.name, row.drives, row.count) == ("width", 2, 6)
    assert row.covered == pytest.approx(0.75)
    assert row.covered_error == pytest.approx(0.25)
    assert row.squared == pytest.approx(0.5 * (1.0 + 9.0 + 6.25) / 4.0)


@pytest.mark.slow
def test_measurements_of_a_drive_are_compared_with_the_world(tmp_path: Path) -> None:
    (tmp_path / "room.toml").write_text(WORLD)
    (drive,) = measure_drives([3], str(tmp_path / "room.toml"), None)
    assert {Kind.AREA, Kind.PERIMETER, Kind.LENGTH, Kind.WIDTH, Kind.ANGLE} <= set(drive.errors)
    assert len(drive.errors[Kind.WIDTH]) == 2
    assert all(np.abs(errors).max() < 5.0 for errors in drive.errors.values())
    assert all(np.abs(errors).max() > 0.0 for errors in drive.errors.values())


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_condition_changes_the_office_where_it_says(name: str) -> None:
    content = office()
    changed, areas = CONDITIONS[name].change(content)
    before, after = (build_world("office", one).segments for one in (content, changed))
    assert (len(areas) > 0) == (name != "unchanged")
    if not areas:
        np.testing.assert_array_equal(before, after)
        return
    old, new = ({tuple(row) for row in segments.round(6).tolist()} for segments in (before, after))
    for x0, y0, x1, y1 in new - old:
        if "doors" not in name and "shifted" not in name:  # a change of a door changes the walls beside it
            middle = 0.5 * np.array([x0 + x1, y0 + y1])
            assert any(np.abs(middle - [x, y]).max() <= max(hx, hy) + 1e-6 for x, y, hx, hy in areas)
    assert len(areas) == (6 if name == "added" else 10 if name.startswith("moved") else len(DOORS))


def test_reports_beside_a_change_find_it_and_others_are_false() -> None:
    near, far = np.array([[[0.9, 0.0], [1.1, 0.0]]]), np.array([[[5.0, 5.0], [6.0, 5.0]]])
    changes = [
        Change(ChangeKind.NEW, None, 1, near),
        Change(ChangeKind.MOVED, 2, 2, near),
        Change(ChangeKind.GONE, 3, None, far),
        Change(ChangeKind.NOT_SEEN_AGAIN, 4, None, far),
    ]
    diff = MapDiff(changes, np.zeros(3), 10, 20, 1.0)
    areas = [(3.0, 2.0, 0.1, 0.1), (-3.0, -2.0, 0.1, 0.1)]
    result = score(diff, areas, np.array([2.0, 2.0, 0.0]))
    assert result == PairResult(changes=2, found=1, reports=3, false=1)
    assert "| 1 of 2 | 1 (< 100 %) | 33.3 % |" in changes_table({"added": [result]})[-1]


def test_a_tenth_of_the_walls_of_a_plan_is_displaced_across() -> None:
    content = load_world_file("office")
    drawn, displaced = displace_walls(content, 0.1, seed=3)
    assert len(displaced) == round(0.1 * len(content.walls)) == 2
    for k, (before, after) in enumerate(zip(content.walls, drawn.walls, strict=True)):
        shift = np.array(after.start) - np.array(before.start)
        np.testing.assert_allclose(np.array(after.end) - np.array(before.end), shift)
        along = np.array(before.end) - np.array(before.start)
        assert abs(shift @ along) < 1e-9
        assert 0.15 <= np.hypot(*shift) <= 0.5 if k in displaced else not shift.any()


def test_differences_at_displaced_walls_are_found_and_others_are_blamed() -> None:
    content = load_world_file("room")
    true = content.walls[1]
    (x0, y0), (x1, y1) = true.start, true.end
    assert x0 == x1
    drawn = true.model_copy(update={"start": (x0 + 0.4, y0), "end": (x1 + 0.4, y1)})
    of_plan = content.model_copy(update={"walls": [drawn if wall is true else wall for wall in content.walls]})
    world = build_world("room", content)
    plan, right = plan_of(build_world("plan", of_plan)).walls, plan_of(world).walls
    built = right  # a perfect map

    def nearest(walls: MapWalls, wall: Wall) -> int:
        middle = 0.5 * (np.array(wall.start) + np.array(wall.end))
        away = np.hypot(*(walls.end_points().mean(axis=1) - middle).T)
        return int(walls.identity[away.argmin()])

    def scored(*reports: Change) -> tuple[int, int, int]:
        return score_plan(reports, plan, built, (world, right), [(true, drawn)])

    nowhere = np.zeros((1, 2, 2))
    old, new = nearest(plan, drawn), nearest(built, true)
    others = nearest(plan, content.walls[0]), nearest(built, content.walls[0])
    assert scored() == (1, 0, 0)
    assert scored(Change(ChangeKind.MOVED, old, new, nowhere)) == (1, 1, 0)
    assert scored(Change(ChangeKind.MOVED, others[0], new, nowhere)) == (1, 1, 1)  # the right place, another wall
    assert scored(Change(ChangeKind.GONE, old, None, nowhere)) == (1, 1, 0)
    assert scored(Change(ChangeKind.NEW, None, new, nowhere)) == (1, 1, 0)
    assert scored(Change(ChangeKind.GONE, others[0], None, nowhere)) == (1, 0, 1)
    assert scored(Change(ChangeKind.NEW, None, others[1], nowhere)) == (1, 0, 1)


def test_the_table_of_plans_leaves_out_drives_without_a_place_in_the_plan() -> None:
    found = PlanDrive(8.0, 0.003, 0.004, 0.002, 2, 1, 3)
    lost = PlanDrive(np.nan, np.nan, np.nan, np.nan, 0, 0, 0)
    row = plans_table({"wrong-walls": [found, lost]})[-1]
    assert "| 2 | 1 | 8.0 m (up to 8.0 m) | 3.0 mm | 4.0 mm | 2.0 mm | 1 of 2 | 3 |" in row


def test_walls_of_a_skewed_world_are_turned_about_their_middles() -> None:
    content, skew = load_world_file("office"), np.radians(1.0)
    skewed = skew_walls(content, skew, 4)
    turned = 0
    for before, after in zip(content.walls, skewed.walls, strict=True):
        old, new = (np.array([wall.start, wall.end]) for wall in (before, after))
        np.testing.assert_allclose(new.mean(axis=0), old.mean(axis=0), atol=1e-9)
        angle = np.arctan2(*(new[1] - new[0])[::-1]) - np.arctan2(*(old[1] - old[0])[::-1])
        assert abs(angle) == pytest.approx(skew) or (new == old).all()
        turned += not (new == old).all()
    assert 0 < turned < len(content.walls) / 4
    assert skew_walls(content, skew, 4) == skewed


def test_a_skewed_wall_that_is_made_regular_counts_as_wrong() -> None:
    """Four walls whose directions have errors of 0.1 degrees; one of them is skewed by so little that it is taken."""
    corners, skew = [(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)], 0.004
    truth = wall_map(room(corners), around(4), covariance=np.diag(np.tile([1e-6, 2e-6], 4)))
    truth = moved(truth, np.array([0.0, 0.0, 0.0, skew, 0.0, 0.0, 0.0, 0.0]))
    estimate = moved(truth, np.array([0.0, 1e-3, 0.0, -1e-3, 0.0, -1e-3, 0.0, 1e-3]))
    result = score_regular(estimate, truth, frozenset({0, 1, 2, 3}), skew)
    assert (result.walls, result.regular, result.skewed, result.wrong) == (4, 4, 1, 1)
    assert result.before == pytest.approx(1e-3)
    table = regularity_table([(skew, [result])])
    assert "| 1 | 4 | 4 | 1 | 1 | 0.057° |" in table[-1]
