"""Links of keyframes of one place: only where the scan fits the old points, and with what is left of their distance."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers import se2
from slam.estimation.keyframe_links import link_revisited
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.localisation.local_field import LocalField, LocalFieldState
from slam.mapping.keyframes import RelativeScanMatch
from slam.matching.scan_features import ScanFeatures
from slam.matching.scan_points import ScanPoints

NOTHING = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
NO_CORNERS = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), int), np.zeros((0, 2)))
PASS = 8  # keyframes of each of two passes through a room


def room(pose: se2.Pose) -> ScanFeatures:
    """Return the points of a scan in a room of 6 by 4 metres with a niche."""
    corners = np.array([[0, 0], [6, 0], [6, 4], [4, 4], [4, 5], [3, 5], [3, 4], [0, 4], [0, 0]], dtype=np.float64)
    sides = [np.linspace(a, b, int(np.hypot(*(b - a)) / 0.05), endpoint=False) for a, b in pairwise(corners)]
    points = se2.transform(se2.inverse(pose), np.concatenate(sides))
    return ScanFeatures(NOTHING, NO_CORNERS, ScanPoints(points))


def link(error: Floats) -> tuple[bool, list[RelativeScanMatch]]:
    """Return if the last keyframe of a second pass is linked, whose poses in the map are wrong by `error`, and matches.

    The matches are those that enter the graph.
    """
    one_pass = np.column_stack([np.linspace(1.0, 3.0, PASS), np.full(PASS, 2.0), np.zeros(PASS)])
    true = np.concatenate([one_pass, one_pass])
    poses = true + np.repeat([np.zeros(3), error], PASS, axis=0)
    field, travelled = LocalField(), np.concatenate([np.linspace(0.0, 2.0, PASS), np.linspace(60.0, 62.0, PASS)])
    for pose in true:
        field.add(room(pose))
    field.restore(LocalFieldState(poses[-1, :2], (), {}, range(PASS, 2 * PASS), poses[PASS:]))  # of the second pass
    motions: list[RelativeScanMatch] = []
    covariances = SimpleNamespace(relative_bound=lambda *_, **__: 1e-4 * np.eye(3))
    parts = SimpleNamespace(connected=lambda keyframes: np.ones(len(keyframes), dtype=bool))
    mapper: Any = SimpleNamespace(
        keyframe_poses=poses,
        keyframe_count=len(poses),
        travelled=travelled.tolist(),
        covariances=covariances,
        landmarks=SimpleNamespace(parts=parts),
        add_scan_match=motions.append,
        graph=SimpleNamespace(has_point_map=lambda _: False, update_until_converged=lambda: None),
        read_back_all=lambda: None,
    )
    model = SimpleNamespace(limit_information=lambda information, travel: information)
    state: Any = SimpleNamespace(mapper=mapper, local_field=field, odometry_model=model)
    scan: Any = SimpleNamespace(travel=np.zeros(3))
    is_linked = link_revisited(state, scan)
    assert is_linked == bool(field.state.links)
    return is_linked, motions


def test_a_new_keyframe_is_linked_with_an_old_one_of_the_same_place() -> None:
    assert link(np.zeros(3))[0]


@pytest.mark.parametrize("error", [[0.3, 0.0, 0.0], [0.0, -0.25, 0.0], [0.2, 0.2, 0.02]])
def test_a_keyframe_that_fits_the_old_points_elsewhere_is_not_linked(error: list[float]) -> None:
    is_linked, motions = link(np.array(error))
    assert not is_linked
    assert not motions


def test_the_error_that_is_left_at_a_link_enters_the_graph() -> None:
    is_linked, (motion,) = link(np.array([0.02, -0.02, 0.01]))
    assert is_linked
    assert motion.start < PASS
    true = np.array([2.0 * (PASS - 1 - motion.start) / (PASS - 1), 0.0, 0.0])
    np.testing.assert_allclose(motion.relative, true, atol=2e-3)
    assert (np.sqrt(np.diag(motion.covariance)) < [0.01, 0.01, 0.003]).all()
