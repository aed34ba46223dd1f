"""The factor graph, compared with an exact Gauss-Newton in numpy that has none of its approximations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
import pytest

from drivers import se2
from slam.errors import MapError
from slam.graph.covariances import ROBUST_COVARIANCE_SCALE
from slam.graph.factor_graph import FIRST_POSE_SIGMAS, FactorGraph
from slam.graph.factors import CAUCHY_SCALE
from slam.graph.final_solution import solve_with_range_bias

ODOMETRY = np.diag([0.02, 0.02, 0.01]) ** 2
# Share of the modelled noise that is drawn, so that the robust kernels have little effect on the comparison.
REDUCED_NOISE = 0.3
# The same if covariances are compared, which contain the weights of the kernels.
MIN_NOISE = 0.1


@dataclass
class World:
    """Truth and measurements.

    wall_observations    (keyframe, wall, frame in the keyframe, covariance)
    corner_observations  (keyframe, corner, position in the keyframe, covariance)
    """

    poses: np.ndarray
    walls: np.ndarray
    corners: np.ndarray
    motions: np.ndarray
    wall_observations: list[tuple[int, int, np.ndarray, np.ndarray]]
    corner_observations: list[tuple[int, int, np.ndarray, np.ndarray]]


def make_world(seed: int, noise_scale: float = REDUCED_NOISE) -> World:
    """Simulate seven poses between five walls and three corners; walls are observed away from their frames' origins."""
    random = np.random.default_rng(seed)
    poses = np.zeros((7, 3))
    for k in range(1, 7):
        poses[k] = se2.compose(poses[k - 1], [0.5, 0.05, random.uniform(-0.3, 0.3)])
    walls = np.array([[1, -1.5, 0.1], [4, 0, 1.5], [1, 2, 3.1], [-1.5, 0, -1.6], [3, 1.5, 2.4]])
    walls += random.normal(0, 0.1, walls.shape)
    corners = np.array([[3.9, -1.4], [3.8, 1.2], [-1.4, 2.0]])
    motions = np.array([perturb(random, se2.between(a, b), noise_scale**2 * ODOMETRY) for a, b in pairwise(poses)])
    wall_observations, corner_observations = [], []
    for k, pose in enumerate(poses):
        for j, wall in enumerate(walls):
            factor = random.normal(0, 1, (2, 2)) * [[0.003], [0.003]] + np.diag([0.004, 0.005])
            covariance = factor @ factor.T
            seen = se2.compose(se2.between(pose, wall), [random.uniform(-1, 1), 0, 0])
            wall_observations.append(
                (k, j, perturb(random, seen, noise_scale**2 * np.pad(covariance, ((1, 0), (1, 0)))), covariance)
            )
        for j, corner in enumerate(corners):
            factor = random.normal(0, 0.004, (2, 2)) + 0.005 * np.eye(2)
            noise = noise_scale * random.multivariate_normal(np.zeros(2), factor @ factor.T)
            position = se2.transform(se2.inverse(pose), corner) + noise
            corner_observations.append((k, j, position, factor @ factor.T))
    return World(poses, walls, corners, motions, wall_observations, corner_observations)


def perturb(random: np.random.Generator, pose: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return a pose with random noise."""
    return se2.compose(pose, random.multivariate_normal(np.zeros(3), covariance))


def make_graph(world: World, offset: float = 0.01, *, batch: bool = False) -> FactorGraph:
    """Build a graph from the measurements as the mapper does, with initial poses that differ from the true ones."""
    graph = FactorGraph()
    starts = world.poses + offset * np.random.default_rng(9).normal(0, [1.0, 1.0, 0.5], world.poses.shape)
    starts[0] = 0.0
    for k, start in enumerate(starts):
        if k == 0:
            graph.add_first_keyframe(start)
        else:
            graph.add_keyframe(k, start, k - 1, world.motions[k - 1], ODOMETRY)
        for _, j, frame, covariance in (observation for observation in world.wall_observations if observation[0] == k):
            predicted = se2.between(start, world.walls[j])
            if k == 0:
                graph.add_wall(k, j, world.walls[j], predicted)
            graph.add_wall_observation(k, j, frame, covariance, predicted)
        for _, j, position, covariance in (
            observation for observation in world.corner_observations if observation[0] == k
        ):
            if k == 0:
                graph.add_corner(j, se2.transform(start, position))
            graph.add_corner_observation(k, j, position, covariance)
        if not batch:
            graph.update()
    if batch:
        graph.solve_batch()
    else:
        graph.update_until_converged()
    return graph


@dataclass
class Exact:
    """Optimum and information (n, n) of small changes: 3 of a pose, 2 of a wall (offset, heading), 2 of a corner."""

    poses: np.ndarray
    walls: np.ndarray
    corners: np.ndarray
    information: np.ndarray

    def covariance(self, first: int, count: int) -> np.ndarray:
        return np.linalg.inv(self.information)[first : first + count, first : first + count]


def apply_change(state: Exact, change: np.ndarray) -> Exact:
    poses, walls, _ = np.split(change, [3 * len(state.poses), 3 * len(state.poses) + 2 * len(state.walls)])
    return replace(
        state,
        poses=se2.compose(state.poses, poses.reshape(-1, 3)),
        walls=se2.compose(state.walls, np.pad(walls.reshape(-1, 2), ((0, 0), (1, 0)))),
        corners=state.corners + change[-2 * len(state.corners) :].reshape(-1, 2),
    )


def residuals(state: Exact, world: World, prior: bool) -> np.ndarray:
    """Return all residuals in units of their standard deviations."""

    def whitened(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
        return np.linalg.solve(np.linalg.cholesky(covariances), errors[..., None]).ravel()

    rows = [state.poses[0] / FIRST_POSE_SIGMAS] if prior else []
    steps = se2.between(world.motions, se2.between(state.poses[:-1], state.poses[1:]))
    rows.append(whitened(steps, np.tile(ODOMETRY, (len(steps), 1, 1))))
    k, j, frames, covariances = map(np.array, zip(*world.wall_observations, strict=True))
    walls = se2.between(se2.compose(state.poses[k], frames), state.walls[j])
    rows.append(whitened(np.column_stack([walls[:, 1] - walls[:, 0] * np.tan(walls[:, 2]), walls[:, 2]]), covariances))
    k, j, positions, covariances = map(np.array, zip(*world.corner_observations, strict=True))
    rows.append(whitened(se2.transform(se2.inverse(state.poses[k]), state.corners[j]) - positions, covariances))
    return np.concatenate(rows)


def make_jacobian(state: Exact, world: World, prior: bool) -> np.ndarray:
    size = 3 * len(state.poses) + 2 * len(state.walls) + 2 * len(state.corners)
    step = 1e-6 * np.eye(size)
    columns = [
        residuals(apply_change(state, s), world, prior) - residuals(apply_change(state, -s), world, prior) for s in step
    ]
    return np.array(columns).T / 2e-6


def solve_exactly(world: World) -> Exact:
    state = Exact(world.poses, world.walls, world.corners, np.zeros((0, 0)))
    for _ in range(6):
        jacobian = make_jacobian(state, world, True)
        state = apply_change(state, -np.linalg.lstsq(jacobian, residuals(state, world, True), rcond=None)[0])
    return replace(state, information=jacobian.T @ jacobian)


def relative_difference(covariance: np.ndarray, other: np.ndarray) -> float:
    """Return the largest relative difference of standard deviations of two covariances in any direction."""
    ratio = np.linalg.eigvals(np.linalg.solve(other, covariance)).real
    return float(np.abs(np.sqrt(ratio) - 1).max())


@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3)), 3])
def test_estimate_equals_exact_solution(seed: int) -> None:
    world = make_world(seed)
    graph, exact = make_graph(world), solve_exactly(world)
    difference = se2.between(exact.poses, graph.keyframe_poses(7))
    np.testing.assert_allclose(difference[:, :2], 0.0, atol=2e-3)
    np.testing.assert_allclose(difference[:, 2], 0.0, atol=1e-3)
    walls = se2.between(graph.wall_frames(range(5)), exact.walls)
    np.testing.assert_allclose(walls[:, 1] - walls[:, 0] * np.tan(walls[:, 2]), 0.0, atol=2e-3)
    np.testing.assert_allclose(walls[:, 2], 0.0, atol=1e-3)
    np.testing.assert_allclose(graph.corner_positions(range(3)), exact.corners, atol=2e-3)


@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3)), 3])
def test_covariances_equal_exact_ones(seed: int) -> None:
    world = make_world(seed, MIN_NOISE)
    graph = make_graph(world, offset=0.0)
    exact = solve_exactly(world)
    at = replace(exact, walls=graph.wall_frames(range(5)))  # frames may slide along the walls
    jacobian = make_jacobian(at, world, True)
    # with so little noise the kernels reduce no weight, but the correction for it is applied all the same
    exact = replace(at, information=jacobian.T @ jacobian / ROBUST_COVARIANCE_SCALE)
    differences = [relative_difference(graph.keyframe_covariance(k), exact.covariance(3 * k, 3)) for k in range(1, 7)]
    marginals = graph.marginals()
    poses, walls, corners = marginals.keyframes(range(7)), marginals.walls(range(5)), marginals.corners(range(3))
    differences += [relative_difference(poses[k], exact.covariance(3 * k, 3)) for k in range(1, 7)]
    differences += [relative_difference(walls[j], exact.covariance(21 + 2 * j, 2)) for j in range(5)]
    differences += [relative_difference(corners[j], exact.covariance(31 + 2 * j, 2)) for j in range(3)]
    assert np.mean(differences) < 0.04
    assert max(differences) < 0.15


def test_robust_covariance_scale_agrees_with_simulation() -> None:
    """Compare the scatter of robust estimates of a point with the inverse of their Hessian."""
    random, scale = np.random.default_rng(0), CAUCHY_SCALE**2
    samples = random.normal(size=(4000, 100, 2))
    estimate = np.zeros((4000, 1, 2))
    for _ in range(10):
        weight = 1 / (1 + ((samples - estimate) ** 2).sum(axis=-1, keepdims=True) / scale)
        estimate = (weight * samples).sum(axis=1, keepdims=True) / weight.sum(axis=1, keepdims=True)
    assert (estimate**2).mean() / (1 / weight.sum(axis=1)).mean() == pytest.approx(ROBUST_COVARIANCE_SCALE, rel=0.04)


def test_relative_covariances_are_those_of_a_map_whose_origin_is_the_keyframe() -> None:
    world = make_world(1, MIN_NOISE)
    graph, last = make_graph(world, offset=0.0), 6
    state = replace(solve_exactly(world), walls=graph.wall_frames(range(5)))
    jacobian = make_jacobian(state, world, prior=False)
    free = np.r_[0 : 3 * last, 3 * last + 3 : jacobian.shape[1]]  # the keyframe is fixed, and nothing else
    covariance = np.linalg.inv(jacobian[:, free].T @ jacobian[:, free])
    own, walls, corners, *_ = graph.relative_covariances([last], range(5), range(3))
    for j in range(5):
        at = slice(18 + 2 * j, 20 + 2 * j)
        assert relative_difference(walls[j], covariance[at, at]) < 0.2
    for j in range(3):
        at = slice(28 + 2 * j, 30 + 2 * j)
        assert relative_difference(corners[j], covariance[at, at]) < 0.2
    pose = graph.keyframe_pose(last)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        own[0], turn @ graph.keyframe_covariance(last) @ turn.T / ROBUST_COVARIANCE_SCALE, rtol=1e-6, atol=1e-12
    )


def test_relative_covariance_in_a_chain_is_that_of_the_motions_between() -> None:
    graph, pose, motion = FactorGraph(), np.zeros(3), np.array([0.5, 0.1, 0.3])
    graph.add_first_keyframe(pose)
    for k in range(1, 7):
        pose = se2.compose(pose, motion)
        graph.add_keyframe(k, pose, k - 1, motion, ODOMETRY)
    graph.update()
    expected = np.zeros((3, 3))
    for _ in range(3):
        adjoint = se2.adjoint(se2.inverse(motion))
        expected = adjoint @ expected @ adjoint.T + ODOMETRY
    np.testing.assert_allclose(
        graph.relative_covariance(2, 5), ROBUST_COVARIANCE_SCALE * expected, rtol=1e-6, atol=1e-12
    )


def two_frames_on_one_wall() -> FactorGraph:
    """Return a graph with walls 0 and 1 on one line, and wall 2 perpendicular to it."""
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    covariance = np.diag([0.01, 0.01]) ** 2
    for wall, frame in enumerate(([1.0, -1.0, 0.01], [2.5, -1.02, -0.01], [3.0, 0.0, 1.57])):
        graph.add_wall(0, wall, np.array(frame), np.array(frame))
        graph.add_wall_observation(0, wall, np.array(frame), covariance, np.array(frame))
    graph.update()
    return graph


def test_wall_equality_aligns_frames() -> None:
    graph = two_frames_on_one_wall()
    first, second, third = graph.wall_frames(range(3))
    graph.add_wall_equality(0, 1, 1.5)
    graph.update()
    graph.update_until_converged()
    one, other, unmoved = graph.wall_frames(range(3))
    between = se2.between(one, other)
    assert np.abs(between[1:]).max() < 2e-3
    assert abs(se2.between(first, second)[1]) > 0.02
    np.testing.assert_allclose(unmoved, third, atol=1e-6)
    assert min(first[1], second[1]) < one[1] < max(first[1], second[1])


def test_converged_estimate_does_not_change_with_further_updates() -> None:
    graph = make_graph(make_world(5))
    poses, walls = graph.keyframe_poses(7), graph.wall_frames(range(5))
    np.testing.assert_array_equal(graph.keyframe_poses(4), poses[:4])
    graph.update_until_converged()
    np.testing.assert_allclose(graph.keyframe_poses(7), poses, atol=2e-4)
    np.testing.assert_allclose(graph.wall_frames(range(5)), walls, atol=2e-4)


def test_undetermined_variable_raises_map_error() -> None:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.add_wall(0, 0, np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    with pytest.raises(MapError, match="the map cannot be estimated"):
        graph.update()


def test_switching_to_qr_keeps_the_estimate() -> None:
    world = make_world(1)
    cholesky, qr = make_graph(world), make_graph(world)
    for graph in (cholesky, qr):
        loops = [graph.add_loop(k, 6, se2.between(world.poses[k], world.poses[6]), 1e-4 * np.eye(3)) for k in (0, 1)]
        graph.update()
        graph.remove_factors(loops[:1])
        if graph is qr:
            graph.solver.switch_to_qr(RuntimeError("Indeterminate linear system"))
        graph.remove_factors(loops[1:])  # whose numbers have changed
        graph.remove_wall_observations({0: 4, 2: 4})
        seen = se2.between(world.poses[5], world.walls[0])
        graph.add_wall_observation(5, 0, seen, np.diag([1e-4, 1e-5]), seen)
        graph.update()
        solve_with_range_bias(graph)
    assert qr.factor_count == cholesky.factor_count
    np.testing.assert_allclose(qr.keyframe_poses(7), cholesky.keyframe_poses(7), atol=1e-6)
    np.testing.assert_allclose(qr.keyframe_covariance(6), cholesky.keyframe_covariance(6), rtol=1e-4)
    with pytest.raises(MapError, match="Indeterminate"):
        qr.solver.switch_to_qr(RuntimeError("Indeterminate linear system"))


class FailingISAM2:
    """An ISAM2 whose marginals cannot be computed."""

    def __init__(self, isam: gtsam.ISAM2) -> None:
        self._isam = isam

    def __getattr__(self, name: str) -> Any:
        return getattr(self._isam, name)

    def marginalCovariance(self, key: int) -> None:  # noqa: N802
        raise RuntimeError("Indeterminate linear system")

    def jointMarginalCovariance(self, keys: Sequence[int]) -> None:  # noqa: N802
        raise RuntimeError("Indeterminate linear system")


@pytest.mark.parametrize(
    "query", [lambda g: g.keyframe_covariance(6), lambda g: g.relative_covariances([6], [0], []).walls]
)
def test_marginals_are_computed_by_qr_if_cholesky_fails(query: Callable[[FactorGraph], np.ndarray]) -> None:
    graph = make_graph(make_world(1))
    before = query(graph)
    graph.solver.isam = FailingISAM2(graph.solver.isam)
    np.testing.assert_allclose(query(graph), before, rtol=1e-4, atol=1e-12)
    graph.solver.isam = FailingISAM2(graph.solver.isam)
    with pytest.raises(MapError, match="Indeterminate"):
        query(graph)


def test_one_wrong_observation_does_not_deform_the_map() -> None:
    world = make_world(2)
    graph = make_graph(world)
    before = graph.keyframe_poses(7)
    predicted = se2.between(before[3], world.walls[1])
    graph.add_wall_observation(3, 1, se2.compose(predicted, [0.0, 0.5, 0.2]), np.eye(2) * 1e-5, predicted)
    graph.update()
    graph.update_until_converged()
    np.testing.assert_allclose(graph.keyframe_poses(7), before, atol=3e-3)


def test_residuals_are_not_reduced_by_the_robust_kernel() -> None:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.add_keyframe(1, np.array([1.0, 0.0, 0.0]), 0, np.array([1.0, 0.0, 0.0]), 1e-8 * np.eye(3))
    graph.add_point_map(0, 1e-8 * np.eye(3))
    graph.add_scan_match(0, 1, np.array([1.05, 0.0, 0.0]), 1e-4 * np.eye(3))
    graph.add_loop(0, 1, np.array([1.05, 0.0, 0.0]), 1e-4 * np.eye(3))
    graph.add_submap_match(0, 1, np.array([1.05, 0.0, 0.0]), 1e-4 * np.eye(3))
    graph.update()
    solve_with_range_bias(graph)
    residuals = graph.residuals()
    robust = 1.0 / (1.0 + 25.0 / 4.0)
    assert residuals.kind[3:] == ("scan match", "odometry", "submap match")
    np.testing.assert_allclose(residuals.squared[3:], [25.0, 25.0, 25.0], rtol=0.02)
    np.testing.assert_allclose(residuals.weight[3:], [robust, 1.0, robust], rtol=0.02)


@pytest.mark.parametrize("batch", [False, True])
def test_residuals_are_the_whitened_errors_of_gtsam(batch: bool) -> None:
    graph = make_graph(make_world(1), batch=batch)
    factors, values = graph.factors_and_values()
    expected = []
    for factor in (factors.at(number) for number in range(factors.size())):
        noise = factor.noiseModel()
        noise = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
        expected.append(np.sum(noise.whiten(factor.unwhitenedError(values)) ** 2))
    residuals = graph.residuals()
    assert max(expected) > 1.0
    assert set(residuals.kind) >= {"prior", "odometry", "wall", "corner", "gauge prior"}
    np.testing.assert_allclose(residuals.squared, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_batch_and_incremental_solutions_agree(seed: int) -> None:
    world = make_world(seed)
    incremental, batch = make_graph(world), make_graph(world, batch=True)
    solve_with_range_bias(incremental)
    assert batch.factor_count == incremental.factor_count
    assert batch.chi2() == pytest.approx(incremental.chi2(), rel=1e-6)
    count = len(world.poses)
    np.testing.assert_allclose(batch.keyframe_poses(count), incremental.keyframe_poses(count), atol=1e-5)
    for k in range(1, count):
        expected = incremental.keyframe_covariance(k)
        np.testing.assert_allclose(batch.keyframe_covariance(k), expected, rtol=1e-2, atol=1e-9)


def test_degrees_of_freedom_are_measurements_less_variables() -> None:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.add_keyframe(1, np.array([1.0, 0.0, 0.0]), 0, np.array([1.0, 0.0, 0.0]), 1e-4 * np.eye(3))
    graph.update()
    assert graph.degrees_of_freedom() == 0  # everything is determined just once
    graph.add_loop(0, 1, np.array([1.01, 0.0, 0.0]), 1e-4 * np.eye(3))
    graph.add_corner(0, np.array([2.0, 1.0]))
    for keyframe, position in ((0, [2.0, 1.0]), (1, [1.0, 1.0])):
        graph.add_corner_observation(keyframe, 0, np.array(position), 1e-4 * np.eye(2))
    graph.update()
    assert graph.degrees_of_freedom() == 3 + 2


def test_factors_and_values_are_copies() -> None:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.update()
    factors, values = graph.factors_and_values()
    values.update(gtsam.symbol("x", 0), gtsam.Pose2(1.0, 2.0, 3.0))
    factors.resize(0)
    np.testing.assert_allclose(graph.keyframe_pose(0), 0.0, atol=1e-12)
    assert graph.chi2() == pytest.approx(0.0)
    assert graph.factors_and_values()[0].size() == 1
