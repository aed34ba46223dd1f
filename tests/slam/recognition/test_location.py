"""The uncertainty of a drive counts in the decision on its place, and so does what it shows outside of the map."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers import se2
from slam.loop_closure.relative_uncertainty import MAX_SQUARED_DISTANCE
from slam.recognition.location import least_mapped
from slam.recognition.placements import Uncertainty

UNCERTAINTY = Uncertainty(np.array([[0.5, 0.2, 0.01], [0.2, 0.8, 0.02], [0.01, 0.02, 0.04]]))
SUBMAP: Any = SimpleNamespace(pose=np.array([3.0, -2.0, 0.7]))


def at(deviations: float) -> se2.Pose:
    """Return a pose that is some standard deviations of UNCERTAINTY away from that of SUBMAP."""
    return se2.compose(SUBMAP.pose, deviations * np.linalg.cholesky(UNCERTAINTY.covariance)[:, 0])


def test_the_density_of_admitted_poses_integrates_to_their_probability() -> None:
    random = np.random.default_rng(1)
    poses = [UNCERTAINTY.draw(SUBMAP, random) for _ in range(4000)]
    densities = np.exp([UNCERTAINTY.log_density(SUBMAP, pose) for pose in poses])
    assert abs(np.mean(densities) - 0.999) < 4.0 * np.std(densities) / np.sqrt(len(poses))
    assert all(UNCERTAINTY.admits(SUBMAP, pose) for pose in poses)


def test_more_must_be_mapped_the_farther_a_place_is_from_the_estimate() -> None:
    least = [least_mapped(UNCERTAINTY.log_density(SUBMAP, at(deviations))) for deviations in (0.0, 1.0, 2.0, 3.0)]
    assert all(one < other for one, other in itertools.pairwise(least))
    assert least[0] < least_mapped(0.0) < least[3] < 1.0


def test_a_place_at_the_border_of_the_uncertainty_is_never_more_likely_than_one_that_is_not_mapped() -> None:
    assert least_mapped(UNCERTAINTY.log_density(SUBMAP, at(np.sqrt(MAX_SQUARED_DISTANCE)))) > 1.0
