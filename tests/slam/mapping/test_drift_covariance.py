"""Correlated drift grows along the drive, and is known where loops or old walls say what it is."""

import numpy as np
import pytest

from slam.geometry.segments import Floats
from slam.graph.factors import Factor, FactorKind
from slam.mapping.drift_covariance import DriftCovariance
from slam.mapping.mapper import Mapper

STEP = np.diag([0.01, 0.0])
"""Square metres by which drift grows along x from each keyframe to the next."""


def driven(parents: list[int], *factors: Factor) -> Mapper:
    """Return a map whose keyframes k = 1, 2, ... follow their `parents`, with more factors in its graph."""
    mapper, count = Mapper(), len(parents) + 1
    mapper.keyframe_count, mapper.keyframe_poses = count, np.zeros((count, 3))
    drift = np.zeros((count, 2, 2))
    odometry = []
    for keyframe, parent in enumerate(parents, start=1):
        drift[keyframe] = drift[parent] + STEP
        odometry.append(Factor(FactorKind.ODOMETRY, parent, keyframe, np.zeros(3), np.eye(3), np.zeros(0)))
    mapper.correlated_drift = drift
    mapper.graph.solver.factors = dict(enumerate([*odometry, *factors]))
    return mapper


def loop(old: int, new: int, sigma: float, kind: FactorKind = FactorKind.LOOP) -> Factor:
    return Factor(kind, old, new, np.zeros(3), sigma**2 * np.eye(3), np.zeros(0))


def along(drift: DriftCovariance, first: int, second: int) -> float:
    return float(drift.between(np.array([first]), np.array([second]))[0, 0, 0])


def test_keyframes_share_the_drift_up_to_their_common_ancestor() -> None:
    drift = DriftCovariance(driven([0, 1, 2, 1, 4, 5]))  # 4 follows 1, as after passing a familiar place
    assert along(drift, 3, 3) == pytest.approx(0.03)
    assert along(drift, 2, 3) == pytest.approx(0.02)
    assert along(drift, 3, 6) == pytest.approx(0.01)
    assert along(drift, 6, 3) == pytest.approx(0.01)


@pytest.mark.parametrize("kind", [FactorKind.LOOP, FactorKind.SCAN_MATCH, FactorKind.SUBMAP_MATCH])
def test_a_loop_or_match_removes_the_drift_at_its_end_and_halves_it_at_the_far_side(kind: FactorKind) -> None:
    drift = DriftCovariance(driven(list(range(10)), loop(0, 10, 0.001, kind)))
    assert along(drift, 10, 10) == pytest.approx(1e-6, rel=0.01)
    assert along(drift, 5, 5) == pytest.approx(0.025, rel=0.01)  # of a Brownian bridge: 0.05 (1 - 1 / 2)
    np.testing.assert_allclose(drift.of(np.arange(11))[:, 1, 1], 0.0, atol=1e-12)


def test_a_loop_that_says_less_than_odometry_changes_nothing() -> None:
    drift = DriftCovariance(driven(list(range(10)), loop(0, 10, 1.0)))
    assert along(drift, 10, 10) == pytest.approx(0.1)


def test_a_wall_removes_the_drift_across_it_only() -> None:
    for heading, left in ((np.pi / 2, 1e-6), (0.0, 0.1)):
        mapper = driven(list(range(10)))
        mapper.landmarks.add_wall(np.array([3.0, 0.0, heading]), 1.0, 0)
        seen = Factor(FactorKind.WALL_OFFSET, 10, 0, np.zeros(4), np.array([[1e-6]]), np.zeros(1))
        mapper.graph.solver.factors[99] = seen
        assert along(DriftCovariance(mapper), 10, 10) == pytest.approx(left, rel=0.01)


def test_the_covariance_is_that_of_drifts_that_fulfil_the_conditions() -> None:
    random, sigma = np.random.default_rng(1), 0.05
    drift = DriftCovariance(driven(list(range(10)), loop(2, 8, sigma)))
    walks: Floats = np.cumsum(random.normal(0.0, 0.1, (200_000, 11)) * (np.arange(11) > 0), axis=1)
    measured = walks[:, 8] - walks[:, 2] + random.normal(0.0, sigma, len(walks))
    slopes = measured @ walks / (measured @ measured)
    left = walks - measured[:, None] * slopes
    expected = np.array([[along(drift, i, j) for j in range(11)] for i in range(11)])
    np.testing.assert_allclose(left.T @ left / len(walks), expected, atol=1e-3)


def test_a_map_without_keyframes_has_no_drift() -> None:
    assert len(DriftCovariance(driven([])).of(np.zeros(0, dtype=np.int64))) == 0


def test_loops_that_say_the_same_more_precisely_than_can_be_computed_count_as_one() -> None:
    drift = DriftCovariance(driven(list(range(10)), *[loop(0, 10, 1e-9)] * 3))
    assert along(drift, 10, 10) == pytest.approx(0.0, abs=1e-9)
    assert along(drift, 5, 5) == pytest.approx(0.025, rel=0.01)
