"""Detection of walls that were mapped twice."""

import numpy as np
import pytest

from slam.geometry.roughness import Roughness
from slam.mapping.keyframes import WallMerge
from slam.mapping.landmarks import Landmarks
from slam.mapping.local_map import LocalMap, local_map_around
from slam.mapping.wall_merging import find_duplicate_wall


def pair(second: tuple[float, float, float], sigma: float = 0.003, half: float = 1.0) -> LocalMap:
    """Return a wall along x and another one."""
    landmarks = Landmarks()
    landmarks.add_wall(np.array([0.0, 0.0, 0.0]), 1.0, keyframe=0)
    landmarks.add_wall(np.array(second), half, keyframe=0)
    landmarks.walls.rows["covariance"][:] = sigma**2 * np.eye(2)
    return local_map_around(landmarks, np.zeros(3), 50.0, np.zeros((1, 3, 3)))


def duplicate(local_map: LocalMap, mature: bool = True, observed: bool = True) -> WallMerge | None:
    return find_duplicate_wall(local_map, np.array([True, mature]), np.array([False, observed]), Roughness(1e-6, 1e-6))


def test_two_landmarks_on_one_wall_are_found() -> None:
    found = duplicate(pair((1.2, 0.004, -0.003)))
    assert found is not None
    assert (found.kept, found.absorbed) == (0, 1)
    assert found.distance < 5.0


@pytest.mark.parametrize(
    "other",
    [
        (1.2, 0.03, 0.0),  # ten standard deviations aside
        (1.2, 0.0, 0.04),  # rotated
        (2.5, 0.0, 0.0),  # beyond its end
        (0.0, 0.0, np.pi),  # facing the other side
        (0.0, 0.0, np.pi / 2),  # perpendicular
    ],
)
def test_different_walls_are_not_merged(other: tuple[float, float, float]) -> None:
    assert duplicate(pair(other)) is None


def test_walls_far_apart_are_not_merged_however_uncertain() -> None:
    assert duplicate(pair((1.2, 0.08, 0.0), sigma=0.1)) is not None
    assert duplicate(pair((1.2, 0.15, 0.0), sigma=0.1)) is None


def test_only_mature_walls_of_which_one_was_just_observed_are_compared() -> None:
    same = pair((1.2, 0.0, 0.0))
    assert duplicate(same, mature=False) is None
    assert duplicate(same, observed=False) is None
