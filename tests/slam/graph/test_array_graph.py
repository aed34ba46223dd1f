"""The graph as arrays: the same cost, steps, retraction and covariances as those of GTSAM, for all kinds of factors."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, P, X

from drivers import se2
from slam.errors import MapError
from slam.graph.array_factors import BETWEEN, squared_distances
from slam.graph.array_graph import ArrayGraph
from slam.graph.block_cholesky import factorise, inverse_blocks, joint_inverse, solve
from slam.graph.block_pattern import Pattern, _ranks
from slam.graph.factor_graph import FactorGraph
from slam.graph.factors import FactorKind, by_kind, keys_of
from slam.graph.gtsam_factors import to_gtsam_graph
from slam.graph.isam2 import IncrementalSolver

BIAS = 0.02


def graph_of_all_kinds(random: np.random.Generator) -> FactorGraph:
    """Return a solved graph with three keyframes and factors of all kinds, with large residuals."""
    graph = FactorGraph()
    poses = np.array([[0.1, -0.2, 0.3], [1.2, 0.1, 2.9], [2.0, 0.4, -2.8]])
    frames = np.array([[1.0, -1.0, 0.1], [2.5, -1.0, 0.1], [3.0, 0.5, 1.6]])
    covariance = random.normal(0.0, 0.05, (3, 3))
    covariance = covariance @ covariance.T + 1e-4 * np.eye(3)
    graph.add_first_keyframe(poses[0])
    for k in (1, 2):
        motion = se2.compose(se2.between(poses[k - 1], poses[k]), random.normal(0.0, 0.1, 3))
        graph.add_keyframe(k, poses[k], k - 1, motion, covariance)
    for j, frame in enumerate(frames):
        graph.add_wall(0, j, frame, se2.between(poses[0], frame))
    graph.add_corner(0, np.array([3.0, -1.0]))
    for k, pose in enumerate(poses):
        for j, frame in enumerate(frames):
            predicted = se2.between(pose, frame)
            seen = se2.compose(predicted, random.normal(0.0, 0.1, 3))
            graph.add_wall_observation(k, j, seen, covariance[1:, 1:], predicted, np.array([0.9, 0.1]))
        seen = se2.transform(se2.inverse(pose), [3.0, -1.0]) + random.normal(0.0, 0.1, 2)
        graph.add_corner_observation(k, 0, seen, covariance[:2, :2], np.array([0.7, 0.7]))
    graph.add_wall_equality(0, 1, 1.5)
    graph.add_loop(0, 2, se2.between(poses[0], poses[2]), covariance)
    graph.add_point_map(0, covariance)
    graph.add_scan_match(0, 2, se2.compose(se2.between(poses[0], poses[2]), [0.2, 0.1, 0.1]), covariance)
    graph.add_plan_wall(1, se2.compose(frames[1], [0.3, 0.2, 0.3]), covariance[:2, :2])
    graph.add_pinned_wall(2, se2.compose(frames[2], [0.1, -0.2, -0.3]), covariance[:2, :2])
    graph.add_pinned_pose(1, se2.compose(poses[1], [0.2, 0.3, -0.3]), covariance)
    graph.update()
    return graph


def test_a_squared_distance_is_not_negative() -> None:
    """The error of a factor that measures one direction can lie across it, as that of a wall's offset."""
    random = np.random.default_rng(0)
    count = 1000
    measured_direction = np.column_stack([random.normal(size=(count, 2)), np.zeros(count)])
    information = 1e4 * measured_direction[:, :, None] * measured_direction[:, None, :]
    across = np.column_stack([-measured_direction[:, 1], measured_direction[:, 0], np.zeros(count)])
    values = np.concatenate([np.zeros((1, 3)), across])
    ends = np.column_stack([np.zeros(count, dtype=np.int64), np.arange(1, count + 1)])
    squared = squared_distances(np.full(count, BETWEEN), ends, np.zeros((count, 3)), information, values)
    assert (squared >= 0.0).all()
    np.testing.assert_allclose(squared, 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_arithmetic_is_that_of_gtsam(seed: int) -> None:
    random = np.random.default_rng(seed)
    graph = graph_of_all_kinds(random)
    factors = graph.solver.sorted_factors()
    arrays, expected = ArrayGraph(factors, BIAS), to_gtsam_graph(factors, BIAS)
    start = arrays.values_of(graph.solver.isam.calculateEstimate())
    moved = np.where(arrays.corners[:, None], [0.1, 0.1, 0.0], [0.1, 0.1, 0.3]) * random.normal(size=start.shape)
    values = arrays.retract(start, moved)
    as_gtsam = arrays.to_values(start).retract(vector_values(arrays, moved))
    np.testing.assert_allclose(arrays.values_of(as_gtsam), values, atol=1e-12)
    assert arrays.cost(values, BIAS) == pytest.approx(2.0 * expected.error(as_gtsam), rel=1e-9)
    step = expected.linearize(as_gtsam).optimize()
    for key, vector in arrays.by_key(arrays.step(values, BIAS)).items():
        np.testing.assert_allclose(vector, step.at(key), atol=1e-7)


def test_keys_of_factors_are_those_of_gtsam() -> None:
    for factor in graph_of_all_kinds(np.random.default_rng(0)).solver.sorted_factors():
        assert set(keys_of(factor)) == set(to_gtsam_graph([factor], 0.0).at(0).keys()), factor.kind


def test_marginals_are_those_of_the_incremental_solver() -> None:
    solver = graph_of_all_kinds(np.random.default_rng(4)).solver
    for key, covariance in solver.marginal_covariances().items():
        np.testing.assert_allclose(covariance, solver.marginal_covariance(key), rtol=1e-5, atol=1e-12)


def test_joint_covariances_are_those_of_the_incremental_solver() -> None:
    solver = graph_of_all_kinds(np.random.default_rng(4)).solver
    groups = [[L(2), L(0)], [X(2), L(1), X(0), P(0)], [L(1)]]
    for group, covariance in zip(groups, solver.joint_covariances(groups), strict=True):
        np.testing.assert_allclose(covariance, solver.joint_covariance(group), rtol=1e-5, atol=1e-12)


def test_covariances_of_distant_variables_follow_the_updates_of_the_graph() -> None:
    graph, keys = graph_of_all_kinds(np.random.default_rng(4)), [X(0), L(0), X(2)]

    def compare(solver: IncrementalSolver) -> None:
        expected = solver.joint_covariance(keys)
        np.testing.assert_allclose(solver.distant_covariance(keys), expected, rtol=1e-3, atol=1e-12)

    compare(graph.solver)
    before = graph.solver.copy()
    graph.add_keyframe(3, np.array([2.5, 0.4, -2.8]), 2, np.array([-0.4, 0.3, 0.0]), 0.01 * np.eye(3))
    loop = graph.add_loop(0, 3, np.array([2.4, 0.6, -3.1]), 1e-4 * np.eye(3))
    graph.update()
    compare(graph.solver)
    graph.remove_factors([loop])
    compare(graph.solver)
    graph.update_until_converged()
    compare(graph.solver)
    compare(before)


def test_arrays_follow_removed_and_added_factors_by_converting_only_the_new_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graph, converted = graph_of_all_kinds(np.random.default_rng(4)), []
    first = graph.solver.arrays()
    graph.remove_factors([next(one for one in graph.solver.sorted_factors() if one.kind is FactorKind.LOOP)])
    graph.add_loop(0, 2, np.array([2.4, 0.6, -3.1]), 1e-4 * np.eye(3))
    graph.update()
    monkeypatch.setattr("slam.graph.array_graph.by_kind", lambda given: converted.extend(given) or by_kind(given))
    arrays = graph.solver.arrays()
    assert len(converted) == 1
    assert len(arrays) == len(first)
    expected = ArrayGraph(graph.solver.sorted_factors(), 0.0)
    values = expected.values_of(graph.solver.estimate())
    np.testing.assert_array_equal(arrays.step(values, 0.0), expected.step(values, 0.0))


@pytest.mark.parametrize("growth", [1.0, 2.0])
def test_a_graph_with_new_variables_is_solved_in_the_order_of_that_before(
    monkeypatch: pytest.MonkeyPatch, growth: float
) -> None:
    monkeypatch.setattr("slam.graph.array_graph.MAX_GROWTH", growth)
    orders = []
    monkeypatch.setattr("slam.graph.block_pattern._ranks", lambda *given: orders.append(given) or _ranks(*given))
    graph = graph_of_all_kinds(np.random.default_rng(5))
    before = graph.solver.arrays()
    before.step(before.values_of(graph.solver.estimate()), 0.0)
    graph.add_keyframe(3, np.array([2.5, 0.4, -2.8]), 2, np.array([-0.4, 0.3, 0.0]), 0.01 * np.eye(3))
    graph.add_corner(1, np.array([4.0, 0.0]))
    graph.add_corner_observation(3, 1, np.array([-1.3, 0.8]), 0.01 * np.eye(2))
    graph.update()
    after = graph.solver.arrays()
    values = after.values_of(graph.solver.estimate())
    steps = after.by_key(after.step(values, 0.0))
    assert len(orders) == (1 if growth > 1.0 else 2)
    expected = ArrayGraph(graph.solver.sorted_factors(), 0.0)
    for key, step in expected.by_key(expected.step(values, 0.0)).items():
        np.testing.assert_allclose(steps[key], step, atol=1e-7)


def test_marginals_that_cholesky_cannot_compute_are_left_to_the_incremental_solver(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solver = graph_of_all_kinds(np.random.default_rng(4)).solver
    expected = solver.marginal_covariances()
    joint = solver.joint_covariances([[L(2), L(0)]])
    monkeypatch.setattr("slam.graph.array_graph.factorise", lambda *_: False)
    np.testing.assert_allclose(solver.joint_covariances([[L(2), L(0)]]), joint, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(solver.distant_covariance([L(2), L(0)]), joint[0], rtol=1e-5, atol=1e-12)
    for key, covariance in solver.marginal_covariances().items():
        np.testing.assert_allclose(covariance, expected[key], rtol=1e-5, atol=1e-12)


def test_undetermined_graph_raises_map_error() -> None:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.add_wall(0, 0, np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    arrays = ArrayGraph(graph.additions.factors, 0.0)
    with pytest.raises(MapError, match="the map cannot be estimated"):
        arrays.step(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), 0.0)


def test_sparse_factorisation_solves_and_inverts() -> None:
    random, count = np.random.default_rng(0), 30
    pairs = np.array([(a, b) for a in range(count) for b in range(a) if b == a - 1 or random.random() < 0.1])
    pattern = Pattern.of_pairs(count, pairs)
    diagonal, below = np.tile(0.1 * np.eye(3), (count, 1, 1)), np.zeros((len(pattern.rows), 3, 3))
    matrix = 0.1 * np.eye(3 * count)
    for (a, b), slot in zip(pattern.rank[pairs], pattern.slots, strict=True):
        first, last = min(a, b), max(a, b)
        root = random.normal(size=(4, 6))
        block = root.T @ root
        rows = np.concatenate([3 * first + np.arange(3), 3 * last + np.arange(3)])
        matrix[np.ix_(rows, rows)] += block
        diagonal[first] += block[:3, :3]
        diagonal[last] += block[3:, 3:]
        below[slot] += block[3:, :3]
    right, inverse = random.normal(size=(count, 3)), np.linalg.inv(matrix)
    assert factorise(pattern, diagonal, below)
    np.testing.assert_allclose(solve(pattern, diagonal, below, right).ravel(), inverse @ right.ravel(), atol=1e-10)
    ranks = np.array([17, 3, count - 1])
    rows = (3 * ranks[:, None] + np.arange(3)).ravel()
    joint = joint_inverse(pattern, diagonal, below, ranks)
    np.testing.assert_allclose(joint, inverse[np.ix_(rows, rows)], atol=1e-10)
    blocks = inverse.reshape(count, 3, count, 3).transpose(0, 2, 1, 3)
    on_diagonal, off_diagonal = inverse_blocks(pattern, diagonal, below)
    np.testing.assert_allclose(on_diagonal, blocks[np.arange(count), np.arange(count)], atol=1e-10)
    columns = np.repeat(np.arange(count), np.diff(pattern.starts))
    np.testing.assert_allclose(off_diagonal, blocks[pattern.rows, columns], atol=1e-10)


def vector_values(arrays: ArrayGraph, vectors: np.ndarray) -> gtsam.VectorValues:
    """Return tangent vectors (n, 3) as GTSAM's."""
    result = gtsam.VectorValues()
    for key, vector in arrays.by_key(vectors).items():
        result.insert(key, vector)
    return result
