"""Weak places: found where covariances are large, with a drive that makes them smaller."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from slam.checks.weak_places import MAX_SIGMA, KeyframePath, WeakKind, find_weak_places, sigma_across
from slam.events import Finished
from slam.mapping.map_features import MapWalls

SQUARE = np.array([[0, 0], [20, 0], [20, 20], [3, 20], [3, 3]], float)
"""Corners of a drive whose end is near its start."""


def along(corners: np.ndarray) -> np.ndarray:
    """Return positions (k, 2) every half metre along straight lines."""
    sides = []
    for start, end in pairwise(corners):
        count = round(2 * float(np.hypot(*(end - start))))
        sides.append(start + np.linspace(0, 1, count, endpoint=False)[:, None] * (end - start))
    return np.concatenate([*sides, corners[-1:]])


def chain_sigma(count: int, step_sigma: np.ndarray, loop: tuple[int, int] | None = None) -> np.ndarray:
    """Return (count,) the standard deviations of positions that are measured relative to the one before.

    step_sigma  (count - 1,) of these measurements
    loop        two positions whose difference is measured as well, to a millimetre
    """
    differences = [(k, k + 1, sigma) for k, sigma in enumerate(step_sigma)]
    information = np.zeros((count, count))
    information[0, 0] = 1e12
    for first, second, sigma in [*differences, *([(*loop, 1e-3)] if loop else [])]:
        information[np.ix_([first, second], [first, second])] += np.array([[1, -1], [-1, 1]]) / sigma**2
    return np.sqrt(np.diagonal(np.linalg.inv(information)))


def path_of(positions: np.ndarray, sigma: np.ndarray) -> KeyframePath:
    return KeyframePath(np.arange(len(positions), dtype=float), positions, sigma)


def no_walls(finished: Finished) -> MapWalls:
    return replace(
        finished.walls,
        frame=np.zeros((0, 3)),
        identity=np.zeros(0, np.int64),
        pieces=(),
        low=np.zeros(0),
        high=np.zeros(0),
        covariance=np.zeros((0, 2, 2)),
    )


def test_the_proposed_drive_makes_the_weak_stretch_known(finished: Finished) -> None:
    positions = along(SQUARE)
    steps = np.full(len(positions) - 1, 0.012)
    before = chain_sigma(len(positions), steps)
    path = path_of(positions, before)
    (place,) = find_weak_places(no_walls(finished), path)
    assert place.kind is WeakKind.STRETCH
    assert "driven once" in place.text
    np.testing.assert_allclose(place.position, positions[-1])  # the drive did not return
    assert place.target is not None
    loop = (path.nearest(place.target), path.nearest(place.position))
    assert before[loop[0]] <= MAX_SIGMA / 2
    after = chain_sigma(len(positions), steps, loop)
    assert after[-1] < MAX_SIGMA < before[-1]
    assert after.max() < 0.6 * before.max()


def test_the_source_of_the_error_is_found_if_it_is_one_place(finished: Finished) -> None:
    positions = along(SQUARE)
    steps = np.full(len(positions) - 1, 0.001)
    steps[60:64] = 0.1  # 2 m about (20, 11), where odometry only measures the motion
    (place,) = find_weak_places(no_walls(finished), path_of(positions, chain_sigma(len(positions), steps)))
    assert place.target is None
    assert np.hypot(*(place.position - [20.0, 11.0])) < 1.0
    assert "Most of the error arises within" in place.text


def test_a_stretch_driven_twice_is_not_called_driven_once(finished: Finished) -> None:
    there = along(np.array([[0.0, 0.0], [40.0, 0.0]]))
    positions = np.concatenate([there, there[-2::-1]])
    sigma = 0.004 * np.abs(positions[:, 0])
    (place,) = find_weak_places(no_walls(finished), path_of(positions, sigma))
    assert "driven once" not in place.text
    np.testing.assert_allclose(place.position, [40.0, 0.0])


@pytest.mark.parametrize("sigma", [0.0, 0.9 * MAX_SIGMA, np.nan])
def test_a_map_that_is_known_everywhere_or_nowhere_has_no_weak_places(finished: Finished, sigma: float) -> None:
    positions = along(SQUARE)
    assert find_weak_places(no_walls(finished), path_of(positions, np.full(len(positions), sigma))) == []
    assert find_weak_places(no_walls(finished), path_of(np.zeros((0, 2)), np.zeros(0))) == []
    assert find_weak_places(no_walls(finished), path_of(positions[:1], np.array([1.0]))) == []


def test_parts_that_are_not_joined_come_first(finished: Finished) -> None:
    positions = along(SQUARE)
    sigma = np.linspace(0.0, 0.2, len(positions))
    part, stretch = find_weak_places(no_walls(finished), path_of(positions, sigma), [50])
    assert (part.kind, stretch.kind) == (WeakKind.PART, WeakKind.STRETCH)
    np.testing.assert_allclose(part.position, positions[50])
    assert part.stamp == 50.0


def test_parts_that_begin_near_each_other_are_one_place(finished: Finished) -> None:
    positions = along(SQUARE)
    places = find_weak_places(no_walls(finished), path_of(positions, np.zeros(len(positions))), [20, 21, 22, 60])
    assert [place.text.split(" that ")[1] for place in places] == [
        "are not joined with the rest",
        "is not joined with the rest",
    ]
    assert places[0].text.startswith("3 parts of the map begin near ")
    np.testing.assert_allclose(places[0].points, positions[20:23])
    assert [place.stamp for place in places] == [20.0, 60.0]


def test_walls_are_weak_if_they_are_less_known_than_the_path_or_rarely_observed(finished: Finished) -> None:
    positions, known = along(np.array([[1.0, 2.0], [5.0, 2.0]])), np.diag([1e-6, 1e-8])
    turning = np.array([[1e-4, 2e-4], [2e-4, 4e-4]])  # its end at +3 m is known to 7 cm
    walls = replace(
        finished.walls, covariance=np.stack([turning, known, known, known]), observations=np.array([9, 9, 9, 2])
    )
    places = find_weak_places(walls, path_of(positions, np.full(len(positions), 0.01)))
    assert [place.kind for place in places] == [WeakKind.WALL, WeakKind.WALL]
    np.testing.assert_allclose(places[0].position, [6.0, 0.0])
    assert places[0].sigma == pytest.approx(0.07)
    assert places[1].text == "Wall 7 (4.0 m) was observed by 2 keyframes only"
    as_weak_as_the_path = path_of(positions, np.full(len(positions), 0.06))
    walls = replace(walls, observations=np.full(4, 9))
    assert all(place.kind is not WeakKind.WALL for place in find_weak_places(walls, as_weak_as_the_path))


def test_sigma_across_a_wall_is_that_of_random_walls(finished: Finished) -> None:
    covariance = np.array([[4e-4, -1e-4], [-1e-4, 9e-5]])
    walls = replace(finished.walls, covariance=np.tile(covariance, (4, 1, 1)))
    offset, heading = np.random.default_rng(1).multivariate_normal(np.zeros(2), covariance, 20000).T
    places = np.array([-2.0, 0.0, 3.0])
    expected = [np.std(offset + distance * heading) for distance in places]
    np.testing.assert_allclose(sigma_across(walls, 0, places), expected, rtol=0.03)
