"""Changes between two maps are found with their significance, and nothing is reported without a change."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pytest

from drivers import se2
from drivers.simulation.world import load_world
from slam.geometry.segments import Floats
from slam.io.sessions import StoredSession, read_session
from slam.mapping.map_features import MapWalls
from slam.mapping.plan import Plan
from slam.mapping.plan_map import PlanMap, build_plan_map
from slam.measuring.wall_map import WallMap
from slam.offline.map_diff import ChangeKind, MapDiff, Survey
from slam.offline.map_diff.comparison import benjamini_hochberg, find_changes
from slam.offline.map_diff.corners import corner_changes
from slam.offline.map_diff.ends import find_ends
from slam.offline.map_diff.movement import find_movements
from slam.offline.map_diff.outputs import diff_text, write_diff_geojson, write_diff_svg
from slam.offline.map_diff.plan import survey_plan
from slam.offline.map_diff.sight import SeenThrough
from slam.offline.map_diff.surveys import shared_scans
from slam.offline.map_diff.wall_pairs import find_pairs
from slam.offline.map_merging.transfer import shift_clock

from ...traced_memory import traced_memory
from ..measuring.plans import around, moved, room, wall_map
from ..outlines import outline, visible

RATE = 0.05
NEW_MAP_AT = np.array([0.4, -0.3, 0.1])
"""Pose of the new map in the old one."""
SAME_FRAME = np.zeros(3)
HALL = [(0.0, 0.0), (8.0, 0.0), (8.0, 3.0), (5.0, 3.0), (5.0, 6.0), (0.0, 6.0)]
PATH = [np.array([x, y, 0.3]) for x, y in zip(np.linspace(0.8, 4.2, 18), np.linspace(1.0, 1.6, 18), strict=True)]
BOX = [(2.6, 3.4), (2.6, 4.4), (3.8, 4.4), (3.8, 3.4)]
"""Clockwise, as its sides are seen from outside."""


SCREEN = [(2.4, 3.4), (2.4, 3.5), (3.6, 3.5), (3.6, 3.4)]
"""A thin box; its side that faces the path is wall 19."""


def hall(
    random: np.random.Generator,
    boxes: Sequence[list[tuple[float, float]]] = (),
    at: Floats = SAME_FRAME,
    path: Sequence[Floats] = PATH,
) -> Survey:
    """Return the survey of a hall with boxes, in a map that is at a pose in the first one's, with random errors."""
    sides = [wall for polygon in (HALL, *boxes) for wall in room(polygon)]
    corners = [
        pair
        for k, polygon in enumerate((HALL, *boxes))
        for pair in around(len(polygon), 6 * min(k, 1) + 4 * max(k - 1, 0))
    ]
    plan = wall_map(sides, corners)
    factor = random.normal(0.0, 1e-3, (2 * len(sides), 2 * len(sides)))  # correlated errors of some millimetres
    factor[1::2] *= 0.3
    joint = factor @ factor.T
    count = np.arange(len(sides))
    blocks = joint.reshape(len(sides), 2, len(sides), 2)[count, :, count, :]
    plan = replace(plan, covariance=joint, walls=replace(plan.walls, covariance=blocks))
    plan = in_frame(moved(plan, factor @ random.normal(size=len(factor))), at)
    surfaces = np.concatenate([outline(polygon) for polygon in (HALL, *boxes)])
    points = [np.ascontiguousarray(visible(surfaces, pose)) for pose in path]
    return Survey(cast("StoredSession", None), plan, se2.between(at, np.array(path)), points)


def in_frame(plan: WallMap, at: Floats) -> WallMap:
    """Return a map in the frame of a pose."""
    corners = replace(plan.corners, position=se2.transform(se2.inverse(at), plan.corners.position).reshape(-1, 2))
    return replace(plan, walls=replace(plan.walls, frame=se2.between(at, plan.walls.frame)), corners=corners)


def changes_of(old: Survey, new: Survey) -> MapDiff:
    guess = se2.compose(NEW_MAP_AT, [0.02, -0.03, 0.005])
    return find_changes(old, new, guess, RATE)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(5)


def test_an_unchanged_building_is_the_same(random: np.random.Generator) -> None:
    found = changes_of(hall(random, [BOX]), hall(random, [BOX], NEW_MAP_AT))
    assert not found.changes
    assert not found.different
    assert found.same == 10
    np.testing.assert_allclose(found.motion, NEW_MAP_AT, atol=0.01)


@pytest.mark.slow
def test_p_values_of_walls_that_have_not_moved_are_uniform_or_larger(random: np.random.Generator) -> None:
    """Few walls scatter, and variances are only increased: then p-values are larger than uniform ones."""
    p_values = []
    for _ in range(40):
        old, new = hall(random, [BOX]).wall_map, hall(random, [BOX], NEW_MAP_AT).wall_map
        pairs = find_pairs(old.walls, new.walls, NEW_MAP_AT)
        p_values.append(find_movements(old, new, pairs, NEW_MAP_AT).p_value)
    values = np.concatenate(p_values)
    assert len(values) == 400
    for level in (0.05, 0.2, 0.5):
        assert level / 5.0 < np.mean(values < level) < level + 4.0 * np.sqrt(level * (1.0 - level) / len(values))


def test_a_moved_wall_is_found_and_does_not_move_the_map(random: np.random.Generator) -> None:
    old, new = hall(random, [BOX]), hall(random, [BOX], NEW_MAP_AT)
    change = np.zeros(20)
    change[2 * 4] = 0.06  # the wall (5, 6) to (0, 6), to its left
    found = changes_of(old, replace(new, wall_map=moved(new.wall_map, change)))
    (wall,) = found.changes
    assert (wall.kind, wall.old, wall.new) == (ChangeKind.MOVED, 14, 14)
    assert wall.shift == pytest.approx(0.06, abs=4.0 * wall.sigma[0])
    assert wall.p_value < 1e-6
    np.testing.assert_allclose(found.motion, NEW_MAP_AT, atol=0.01)
    shifts = {corner.identity: corner.shift for corner in corner_changes(found, old.wall_map, new.wall_map)}
    assert set(shifts) == {3, 4}  # the ends of this wall
    np.testing.assert_allclose(shifts[3], [0.0, -0.06], atol=0.01)


def test_a_box_is_gone_or_new_where_scans_have_seen_through_its_place(random: np.random.Generator) -> None:
    empty, furnished = hall(random, at=NEW_MAP_AT), hall(random, [BOX])
    gone = changes_of(furnished, empty)
    assert {(change.kind, change.old) for change in gone.changes if change.kind is not ChangeKind.NOT_SEEN_AGAIN} == {
        (ChangeKind.GONE, 19)  # the side that faces the path; nothing was known of the others from there
    }
    new = changes_of(hall(random), hall(random, [BOX], NEW_MAP_AT))
    assert [(change.kind, change.new) for change in new.changes if change.kind is ChangeKind.NEW] == [
        (ChangeKind.NEW, 19)
    ]
    np.testing.assert_allclose(sorted(new.changes[0].stretches[0][:, 0]), [2.6, 3.8], atol=0.25)


@pytest.mark.parametrize("longer", [0.2, -0.2])
def test_an_end_that_was_moved_along_its_wall_is_found(random: np.random.Generator, longer: float) -> None:
    stretched = [(x + longer if x > 3.0 else x, y) for x, y in SCREEN]
    found = changes_of(hall(random, [SCREEN]), hall(random, [stretched], NEW_MAP_AT))
    (end,) = [change for change in found.changes if change.kind is ChangeKind.END_MOVED]
    assert (end.old, end.new) == (19, 19)
    assert end.shift == pytest.approx(longer, abs=4.0 * end.sigma[0])
    assert end.sigma[0] < 0.03
    np.testing.assert_allclose(end.stretches[0], [[3.6, 3.4], [3.6 + longer, 3.4]], atol=0.05)
    assert "longer" in diff_text(found, []) if longer > 0.0 else "shorter" in diff_text(found, [])
    assert found.different


@pytest.mark.parametrize("longer", [0.1, -0.1])
def test_the_jamb_at_an_end_is_not_the_wall_beside_it(random: np.random.Generator, longer: float) -> None:
    """From beyond an end, beams end on the jamb, at the place of the end: with noise, also where the wall was."""
    path = [np.array([x, 1.2, 0.3]) for x in np.linspace(0.8, 7.2, 33)]
    stretched = [(x + longer if x > 3.0 else x, y) for x, y in SCREEN]
    old, new = hall(random, [SCREEN], path=path), hall(random, [stretched], NEW_MAP_AT, path)
    found = changes_of(with_noise(random, old), with_noise(random, new))
    (end,) = [change for change in found.changes if change.kind is ChangeKind.END_MOVED]
    assert end.through > 10
    assert end.seen == 0


def with_noise(random: np.random.Generator, survey: Survey) -> Survey:
    """Return a survey with noise of 1 cm in its ranges."""
    ranges = [np.hypot(points[:, 0], points[:, 1])[:, None] for points in survey.points]
    noisy = [
        points * (1.0 + random.normal(0.0, 0.01, r.shape) / r) for points, r in zip(survey.points, ranges, strict=True)
    ]
    return replace(survey, points=noisy)


def test_ends_that_something_hides_are_not_ends(random: np.random.Generator) -> None:
    """A box in front of a wall ends what is seen of the wall, in the new drive at another place."""
    box = [(2.4, 5.0), (2.4, 5.4), (3.4, 5.4), (3.4, 5.0)]
    moved_box = [(x + 0.3, y) for x, y in box]
    old, new = hall(random, [box]), hall(random, [moved_box], NEW_MAP_AT)
    ends = {end.wall for end in find_ends(old, np.arange(len(old.wall_map.walls)))}
    assert 4 not in ends  # the wall behind the box
    assert all(change.old != 14 for change in changes_of(old, new).changes)


def test_a_wall_that_no_scan_has_looked_at_is_not_gone(random: np.random.Generator) -> None:
    old, new = hall(random, [BOX]), hall(random, at=NEW_MAP_AT)
    blind = replace(new, poses=new.poses[:0], points=[])
    kinds = {change.kind for change in changes_of(old, blind).changes}
    assert kinds == {ChangeKind.NOT_SEEN_AGAIN}
    assert not changes_of(old, blind).different


def test_glass_that_both_drives_see_through_now_and_then_has_not_gone() -> None:
    assert SeenThrough(0, (0.0, 1.0), through=9, seen=3, own=(8, 10)).p_value > 0.05
    assert SeenThrough(0, (0.0, 1.0), through=9, seen=3, own=(0, 18)).p_value < 1e-3


@pytest.mark.parametrize(
    ("through", "seen", "own"), [(0, 5, (3, 4)), (9, 3, (8, 10)), (40, 0, (0, 70)), (7, 2, (0, 0))]
)
def test_p_values_of_stretches_are_those_of_the_exact_test(through: int, seen: int, own: tuple[int, int]) -> None:
    from scipy.stats import fisher_exact  # here, as its import takes a second

    expected = fisher_exact([[through, seen], list(own)], alternative="greater").pvalue
    assert SeenThrough(0, (0.0, 1.0), through, seen, own).p_value == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("hides", [True, False])
def test_a_wall_that_a_plan_hides_has_not_moved_from_what_hides_it(random: np.random.Generator, hides: bool) -> None:
    """The front of a cupboard, 27 cm before a wall, has gone; without the wall in the plan, the front has moved."""
    front = [[(7.73, 0.0), (7.73, 3.0)]]
    walls = [[HALL[k], HALL[(k + 1) % len(HALL)]] for k in range(len(HALL)) if hides or k != 1]
    walls += [[BOX[k - 1], BOX[k]] for k in range(4)]
    lines = np.array(walls + front)
    drawn = Plan("hall", lines, np.ones(len(lines), dtype=bool), 1e-3, np.array(PATH)[:, :2])
    plan = survey_plan(build_plan_map(drawn, (0.03, 0.005)))
    found = find_changes(plan, hall(random, [BOX]), np.zeros(3), RATE)
    moved = [change.shift for change in found.changes if change.kind is ChangeKind.MOVED]
    assert moved == ([] if hides else [pytest.approx(-0.27, abs=0.02)])


def test_a_large_plan_needs_no_joint_covariance_of_its_walls() -> None:
    count = 5000
    rows, zeros = np.arange(count), np.zeros(count)
    frames = np.column_stack([rows, zeros, zeros])
    pieces = tuple(np.array([[-0.4, 0.4]]) for _ in range(count))
    blocks = np.tile(np.diag([9e-4, 2.5e-5]), (count, 1, 1))
    walls = MapWalls(rows, frames, zeros - 0.4, zeros + 0.4, np.ones(count, dtype=np.int64), blocks, pieces)
    plan = Plan("long", np.zeros((1, 2, 2)), np.zeros(1, dtype=bool), 1e-3)
    with traced_memory() as memory:
        survey = survey_plan(PlanMap(plan, walls, np.zeros((0, 2, 2)), ()))
    assert memory.peak < 20e6  # bytes; the joint covariance would have 800 million
    np.testing.assert_array_equal(survey.wall_map.joint_covariance(np.array([7, 3])), np.diag([9e-4, 2.5e-5] * 2))


def test_false_discoveries_are_controlled(random: np.random.Generator) -> None:
    """Of 200 tests 20 are of true changes; the mean share of false ones among the discoveries is at most the rate."""
    shares = []
    for _ in range(200):
        p_values = np.concatenate([random.uniform(size=180), 1e-4 * random.uniform(size=20)])
        found = benjamini_hochberg(p_values, 200, RATE)
        shares.append(found[:180].sum() / max(found.sum(), 1))
        assert found[180:].all()
    assert np.mean(shares) < RATE + 0.015
    assert not benjamini_hochberg(np.array([0.01]), 100, RATE).any()  # one of a hundred
    assert not len(benjamini_hochberg(np.zeros(0), 10, RATE))


def test_outputs_name_the_changes(random: np.random.Generator, tmp_path: Path) -> None:
    old, new = hall(random), hall(random, [BOX], NEW_MAP_AT)
    found = changes_of(old, new)
    corners = corner_changes(found, old.wall_map, new.wall_map)
    text = diff_text(found, corners)
    assert text.splitlines()[0].startswith("new: ")
    assert "6 walls are the same" in text
    assert "no wall has moved" not in text
    unchanged = diff_text(changes_of(old, hall(random)), [])
    assert unchanged.startswith("no wall has moved, is gone or is new; 6 walls are the same")
    write_diff_geojson(tmp_path / "a.geojson", found, corners)
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    wall = next(feature for feature in features if feature["properties"]["change"] == "new")
    assert wall["properties"]["new"] == 19
    assert wall["properties"]["seen_through_by"] > 10
    np.testing.assert_allclose([point[1] for point in wall["geometry"]["coordinates"][0]], 3.4, atol=0.05)
    write_diff_svg(tmp_path / "a.svg", found, old.wall_map, new.wall_map)
    classes = [child.attrib.get("class") for child in ElementTree.parse(tmp_path / "a.svg").getroot()]
    assert classes.count("new") == 1
    assert classes.count("same") == 6
    assert classes.count("scale") == 1
    certain = replace(found, changes=[replace(change, p_value=1e-200) for change in found.changes])
    assert "p < 1e-99" in diff_text(certain, corners)
    write_diff_svg(tmp_path / "b.svg", certain, old.wall_map, new.wall_map)
    titles = [title.text or "" for title in ElementTree.parse(tmp_path / "b.svg").getroot().iterfind("*/{*}title")]
    assert sum(title.endswith("p < 1e-99") for title in titles) == 1


def test_maps_without_a_common_place_are_an_error(wclm: Any, tmp_path: Path) -> None:
    result = wclm("run", "sim:room?duration=6&lidar=short", "--out", "room", "--no-review")
    assert result.exit_code == 0, result.output
    other = wclm("run", "sim:room?duration=6&seed=1&lidar=short", "--out", "other", "--no-review")
    assert other.exit_code == 0, other.output
    wclm.refuses("diff", "room", "other", because=["room, other: the maps cannot be aligned"])
    assert "scans" not in wclm("diff", "room", "other", "--at", "0,0,0").stderr
    assert wclm("diff", "room", "room", "--at", "0.1,0").exit_code == 2
    wclm.refuses("diff", "room", "nowhere", because=["nowhere: no such directory"])
    wclm.refuses("diff", "room", "room", "--svg", "a.png", because=["a.png", ".svg"])


def test_maps_of_the_same_scans_are_aligned_by_these(wclm: Any, tmp_path: Path) -> None:
    """A drive that is too short to be recognised anywhere is at the same place as its refinement."""
    assert wclm("run", "sim:room?duration=6&lidar=short", "--out", "room", "--no-review").exit_code == 0
    assert wclm("optimize", "room", "--out", "better", "--no-review").exit_code == 0
    same = wclm("diff", "room", "better")
    assert same.exit_code == 0, same.output
    assert "no wall has moved" in same.stdout
    assert "32 scans of better are also in room" in same.stderr
    # also if the clock of one of them was shifted, as that of a later session is when merging
    sessions = [read_session(Path("room")), shift_clock(read_session(Path("better")), 77.0)]
    surveys = [replace(hall(np.random.default_rng(1)), session=session) for session in sessions]
    assert shared_scans(*surveys) == [(row, row) for row in range(32)]
    assert not shared_scans(surveys[0], replace(surveys[1], session=replace(sessions[1], recordings=[])))


@pytest.mark.slow
def test_drives_through_an_office_with_and_without_changes(wclm: Any, tmp_path: Path) -> None:
    """The exit status is that of diff; all changed boxes are found, and nothing else."""
    source = Path(__file__).parents[3] / "datasets" / "worlds" / "office.toml"
    changed = source.read_text().replace("at = [22.4, 4.7]", "at = [22.4, 4.75]")  # a cupboard, moved by 5 cm
    changed += "\n[[boxes]]\nat = [16.5, 4.26]\nsize = [1.0, 0.4]\n"
    (tmp_path / "changed.toml").write_text(changed)
    assert len(load_world(tmp_path / "changed.toml").segments) == len(load_world("office").segments) + 4
    for name, spec in (("a", "office?seed=1"), ("b", "office?seed=2"), ("c", f"{tmp_path}/changed.toml?seed=3")):
        assert wclm("run", f"sim:{spec}&duration=100", "--out", name, "--no-review").exit_code == 0
    same = wclm("diff", "a", "b")
    assert same.exit_code == 0, same.output
    exported = wclm("map", "a", "--format", "svg")
    assert exported.exit_code == 0, exported.output
    itself = wclm("diff", "a/map.svg", "a")  # its lines cover doors that the scans have seen through
    assert itself.exit_code == 0, itself.output
    different = wclm("diff", "a", "c", "--svg", "a.svg", "--geojson", "a.geojson")
    assert different.exit_code == 1, different.output
    walls = [
        one for one in json.loads(Path("a.geojson").read_text())["features"] if one["properties"]["kind"] == "wall"
    ]
    changes = [one["properties"]["change"] for one in walls]
    assert changes.count("moved") == 1
    assert changes.count("new") >= 1
    assert "gone" not in changes
    shift = next(one["properties"] for one in walls if one["properties"]["change"] == "moved")
    assert abs(shift["shift"]) == pytest.approx(0.05, abs=4.0 * shift["sigma_shift"])
