"""Right angles and parallels: what is accepted, what is left alone, and how much angles improve."""

from dataclasses import replace

import numpy as np
import pytest

from slam.measuring.measurement import measure_angle
from slam.measuring.regularity import regularise
from slam.measuring.wall_map import WallMap

from .plans import wall_map

HEADING_SIGMA, OFFSET_SIGMA = np.radians(0.15), 0.005
WALLS = 14


def measured(rng: np.random.Generator, skews: dict[int, float], sigmas: np.ndarray) -> WallMap:
    """Return a map of walls along two axes, some of them skewed (radians), with correlated errors of their headings."""
    walls = []
    for k in range(WALLS):
        turn = 0.2 + k % 4 * np.pi / 2 + skews.get(k, 0.0)
        centre, along = rng.uniform(-15.0, 15.0, 2), np.array([np.cos(turn), np.sin(turn)])
        walls.append([tuple(centre - 2.0 * along), tuple(centre + 2.0 * along)])
    common = rng.normal(0.0, 1.0, (2 * WALLS, 3))
    scale = np.column_stack([np.full(WALLS, OFFSET_SIGMA), sigmas]).ravel()
    correlated = np.eye(2 * WALLS) + 0.3 * common @ common.T
    deviation = np.sqrt(np.diag(correlated))
    covariance = correlated * np.outer(scale / deviation, scale / deviation)
    truth = wall_map(walls, covariance=covariance)
    error = rng.multivariate_normal(np.zeros(2 * WALLS), covariance)
    x, y, heading = truth.walls.frame.T
    frame = np.column_stack([x - np.sin(heading) * error[::2], y + np.cos(heading) * error[::2], heading + error[1::2]])
    return replace(truth, walls=replace(truth.walls, frame=frame))


def axis_errors(result: WallMap, rows: list[int]) -> np.ndarray:
    """Return the errors of the directions of regular walls relative to their mean, radians."""
    heading = result.walls.frame[rows, 2] - 0.2
    difference = np.remainder(heading + np.pi / 4, np.pi / 2) - np.pi / 4
    return np.asarray(difference - difference.mean())


def test_regular_walls_become_exactly_regular_and_angles_improve() -> None:
    rng, before, after, alone = np.random.default_rng(0), [], [], 0
    every = list(range(WALLS))
    for _ in range(30):
        original = measured(rng, {}, np.full(WALLS, HEADING_SIGMA))
        found = regularise(original)
        alone += len(found.alone)
        before.append(axis_errors(original, every))
        after.append(axis_errors(found.wall_map, every))
        rows = found.groups[0]
        assert np.ptp(axis_errors(found.wall_map, rows)) < 1e-9
        angle = measure_angle(found.wall_map, rows[0], rows[1])
        assert np.remainder(angle.value + np.pi / 4, np.pi / 2) == pytest.approx(np.pi / 4, abs=1e-9)
        assert angle.sigma < 1e-6
    assert alone <= 2  # 0.1 % of 420 are expected
    assert np.std(after) < 0.1 * np.std(before)


def test_the_covariance_of_a_regular_map_is_that_of_its_errors() -> None:
    rng, squared, stated = np.random.default_rng(1), [], []
    for _ in range(60):
        original = measured(rng, {}, np.full(WALLS, HEADING_SIGMA))
        regular = regularise(original).wall_map
        common = np.remainder(regular.walls.frame[0, 2] - 0.2 + np.pi / 4, np.pi / 2) - np.pi / 4
        squared.append(common**2)
        stated.append(regular.covariance[1, 1])
        assert regular.covariance[1, 1] < original.covariance[1, 1]
        assert np.linalg.eigvalsh(regular.covariance).min() > -1e-12
    assert np.mean(squared) / np.mean(stated) == pytest.approx(1.0, abs=0.45)


@pytest.mark.parametrize("sigma", [0.03, 0.15, 0.4, 2.0])
def test_a_wall_skewed_by_one_degree_stays_as_it_is(sigma: float) -> None:
    """However well its direction is known."""
    rng, accepted, moved = np.random.default_rng(2), 0, []
    sigmas = np.full(WALLS, HEADING_SIGMA)
    sigmas[5] = np.radians(sigma)
    for _ in range(40):
        original = measured(rng, {5: np.radians(1.0)}, sigmas)
        found = regularise(original)
        accepted += 5 not in found.alone
        difference = found.wall_map.walls.frame[5, 2] - original.walls.frame[5, 2]
        moved.append(difference if 5 in found.alone else 0.0)
        assert len(found.groups) == 1
    assert accepted <= 2  # at most 1 % of 40 are expected
    assert np.abs(moved).max() < 3.5 * sigmas.max()  # only the error that it has in common with the others


def test_walls_whose_directions_are_not_known_well_enough_are_left_alone() -> None:
    original = measured(np.random.default_rng(3), {}, np.full(WALLS, np.radians(2.0)))
    found = regularise(original)
    assert found.groups == []
    np.testing.assert_allclose(found.wall_map.walls.frame, original.walls.frame)
    assert found.text == f"no walls are parallel or at right angles, {WALLS} are left as they are"


def test_two_wings_that_are_turned_against_each_other_are_two_groups() -> None:
    turned = dict.fromkeys(range(8, WALLS), np.radians(30.0))
    found = regularise(measured(np.random.default_rng(4), turned, np.full(WALLS, HEADING_SIGMA)))
    assert [sorted(group) for group in found.groups] == [list(range(8)), list(range(8, WALLS))]


def test_corners_stay_on_both_walls() -> None:
    walls = [[(0, 0), (4, 0.01)], [(4, 0), (4.01, 3)], [(4, 3), (0, 3.01)], [(0, 3), (0.02, 0)]]
    original = wall_map(walls, corners=[(0, 1), (1, 2), (2, 3), (3, 0)], covariance=np.diag([1e-5] * 8))
    result = regularise(original).wall_map
    for k in range(4):
        np.testing.assert_allclose(result.corners.position[k], result.intersection(k, (k + 1) % 4)[0], atol=1e-9)
