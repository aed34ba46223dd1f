"""Odometry past familiar places leads along the pass itself after its closure was forbidden."""

from __future__ import annotations

import numpy as np

from drivers import se2
from slam.config import OdometryConfig
from slam.estimation.refinement import ScanHistory
from slam.graph.factors import Factor, FactorKind
from slam.odometry.error_model import OdometryModel
from slam.odometry.history import OdometryHistory
from slam.offline.corrections.detours import direct_motions, is_detour, without_detours
from slam.preprocessing.preprocessor import NO_FEATURES, ProcessedScan

KEYFRAMES = np.array([0, 1, 2, 3, 6, 7])
OWN_KEYFRAMES = np.array([0, 1, 2, 3, 1, 1, 4, 5])
"""The fifth and the sixth scan were at the place of the second keyframe, as the program had it."""


def history() -> ScanHistory:
    scans = [ProcessedScan(float(k), np.array([0.5 * k, 0.0, 0.1 * k]), NO_FEATURES) for k in range(len(OWN_KEYFRAMES))]
    relative = np.tile([0.02, 0.0, 0.0], (len(scans), 1)) * (OWN_KEYFRAMES == 1)[:, None]
    informations = np.tile(np.eye(3), (len(scans), 1, 1))
    return ScanHistory(scans, KEYFRAMES, OWN_KEYFRAMES, relative, informations, OdometryHistory(), frozenset())


def odometry(first: int, second: int) -> Factor:
    return Factor(FactorKind.ODOMETRY, first, second, np.zeros(3), np.eye(3))


def test_motions_from_keyframes_of_an_earlier_pass_are_replaced() -> None:
    factors = [odometry(0, 1), odometry(1, 2), odometry(2, 3), odometry(1, 4), odometry(4, 5)]
    assert [is_detour(factor, range(3, 6)) for factor in factors] == [False, False, False, True, False]
    (motion,) = direct_motions(factors, history(), OdometryModel(OdometryConfig()), range(3, 6))
    assert (motion.kind, motion.first, motion.second) == (FactorKind.ODOMETRY, 3, 4)
    scans = history().scans
    np.testing.assert_allclose(motion.measured, se2.between(scans[3].odometry, scans[6].odometry), atol=0.02)
    assert np.linalg.eigvalsh(motion.covariance).min() > 0.0


def test_scans_are_relative_to_keyframes_of_their_own_pass() -> None:
    before, after = history(), without_detours(history(), range(3, 6))
    np.testing.assert_array_equal(after.own_keyframes, [0, 1, 2, 3, 3, 3, 4, 5])
    for row in (4, 5):
        expected = se2.between(before.scans[3].odometry, before.scans[row].odometry)
        np.testing.assert_allclose(after.relative[row], expected)
        assert not after.informations[row].any()
    others = [0, 1, 2, 3, 6, 7]
    np.testing.assert_array_equal(after.relative[others], before.relative[others])
    np.testing.assert_array_equal(before.own_keyframes, OWN_KEYFRAMES)
