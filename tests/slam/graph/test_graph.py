"""The factor graph against an exact Gauss-Newton in numpy, written without any of its approximations."""

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
from slam.graph.backend import FIRST_POSE_SIGMAS, FactorGraph
from slam.graph.covariances import ROBUST_COVARIANCE_SCALE
from slam.graph.factors import CAUCHY_SCALE

ODOMETRY = np.diag([0.02, 0.02, 0.01]) ** 2
QUIET = 0.3  # of the claimed noise is drawn, so that the robust kernels stay out of the comparison
SILENT = 0.1  # the same where covariances are compared, into which the kernels' weights go


@dataclass
class World:
    """Truth and measurements: (from, wall, frame seen, covariance), (from, corner, position seen, covariance)."""

    poses: np.ndarray
    walls: np.ndarray
    corners: np.ndarray
    motions: np.ndarray
    wall_views: list[tuple[int, int, np.ndarray, np.ndarray]]
    corner_views: list[tuple[int, int, np.ndarray, np.ndarray]]


def make_world(seed: int, share: float = QUIET) -> World:
    """A drive of seven poses past five walls and three corners, each wall seen off its frame's origin."""
    random = np.random.default_rng(seed)
    poses = np.zeros((7, 3))
    for k in range(1, 7):
        poses[k] = se2.compose(poses[k - 1], [0.5, 0.05, random.uniform(-0.3, 0.3)])
    walls = np.array([[1, -1.5, 0.1], [4, 0, 1.5], [1, 2, 3.1], [-1.5, 0, -1.6], [3, 1.5, 2.4]])
    walls += random.normal(0, 0.1, walls.shape)
    corners = np.array([[3.9, -1.4], [3.8, 1.2], [-1.4, 2.0]])
    motions = np.array([drawn(random, se2.between(a, b), share**2 * ODOMETRY) for a, b in pairwise(poses)])
    wall_views, corner_views = [], []
    for k, pose in enumerate(poses):
        for j, wall in enumerate(walls):
            factor = random.normal(0, 1, (2, 2)) * [[0.003], [0.003]] + np.diag([0.004, 0.005])
            covariance = factor @ factor.T
            seen = se2.compose(se2.between(pose, wall), [random.uniform(-1, 1), 0, 0])
            wall_views.append((k, j, drawn(random, seen, share**2 * np.pad(covariance, ((1, 0), (1, 0)))), covariance))
        for j, corner in enumerate(corners):
            factor = random.normal(0, 0.004, (2, 2)) + 0.005 * np.eye(2)
            noise = share * random.multivariate_normal(np.zeros(2), factor @ factor.T)
            position = se2.transform(se2.inverse(pose), corner) + noise
            corner_views.append((k, j, position, factor @ factor.T))
    return World(poses, walls, corners, motions, wall_views, corner_views)


def drawn(random: np.random.Generator, pose: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return se2.compose(pose, random.multivariate_normal(np.zeros(3), covariance))


def graph_of(world: World, strays: float = 0.01, *, batch: bool = False) -> FactorGraph:
    """The world's measurements in the graph, as the mapper puts them there, at poses that stray from the true ones."""
    graph = FactorGraph()
    starts = world.poses + strays * np.random.default_rng(9).normal(0, [1.0, 1.0, 0.5], world.poses.shape)
    starts[0] = 0.0
    for k, start in enumerate(starts):
        if k == 0:
            graph.add_first_keyframe(start)
        else:
            graph.add_keyframe(k, start, k - 1, world.motions[k - 1], ODOMETRY)
        for _, j, frame, covariance in (view for view in world.wall_views if view[0] == k):
            believed = se2.between(start, world.walls[j])
            if k == 0:
                graph.add_wall(k, j, world.walls[j], believed)
            graph.observe_wall(k, j, frame, covariance, believed)
        for _, j, position, covariance in (view for view in world.corner_views if view[0] == k):
            if k == 0:
                graph.add_corner(j, se2.transform(start, position))
            graph.observe_corner(k, j, position, covariance)
        if not batch:
            graph.update()
    if batch:
        graph.solve()
    else:
        graph.settle()
    return graph


@dataclass
class Exact:
    """The optimum and the information (n, n) of small changes: 3 a pose, 2 a wall (offset, heading), 2 a corner."""

    poses: np.ndarray
    walls: np.ndarray
    corners: np.ndarray
    information: np.ndarray

    def covariance(self, first: int, count: int) -> np.ndarray:
        return np.linalg.inv(self.information)[first : first + count, first : first + count]


def moved(state: Exact, change: np.ndarray) -> Exact:
    poses, walls, _ = np.split(change, [3 * len(state.poses), 3 * len(state.poses) + 2 * len(state.walls)])
    return replace(
        state,
        poses=se2.compose(state.poses, poses.reshape(-1, 3)),
        walls=se2.compose(state.walls, np.pad(walls.reshape(-1, 2), ((0, 0), (1, 0)))),
        corners=state.corners + change[-2 * len(state.corners) :].reshape(-1, 2),
    )


def residuals(state: Exact, world: World, prior: bool) -> np.ndarray:
    """All of them, each in units of its standard deviation."""

    def whitened(error: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        return np.linalg.solve(np.linalg.cholesky(covariance), error)

    rows = [state.poses[0] / FIRST_POSE_SIGMAS] if prior else []
    for k, motion in enumerate(world.motions):
        rows.append(whitened(se2.between(motion, se2.between(state.poses[k], state.poses[k + 1])), ODOMETRY))
    for k, j, frame, covariance in world.wall_views:
        wall = se2.between(se2.compose(state.poses[k], frame), state.walls[j])
        rows.append(whitened(np.array([wall[1] - wall[0] * np.tan(wall[2]), wall[2]]), covariance))
    for k, j, position, covariance in world.corner_views:
        rows.append(whitened(se2.transform(se2.inverse(state.poses[k]), state.corners[j]) - position, covariance))
    return np.concatenate(rows)


def jacobian_of(state: Exact, world: World, prior: bool) -> np.ndarray:
    size = 3 * len(state.poses) + 2 * len(state.walls) + 2 * len(state.corners)
    step = 1e-6 * np.eye(size)
    columns = [residuals(moved(state, s), world, prior) - residuals(moved(state, -s), world, prior) for s in step]
    return np.array(columns).T / 2e-6


def solve(world: World) -> Exact:
    state = Exact(world.poses, world.walls, world.corners, np.zeros((0, 0)))
    for _ in range(6):
        jacobian = jacobian_of(state, world, True)
        state = moved(state, -np.linalg.lstsq(jacobian, residuals(state, world, True), rcond=None)[0])
    return replace(state, information=jacobian.T @ jacobian)


def apart(covariance: np.ndarray, other: np.ndarray) -> float:
    """By what share the standard deviations of two covariances differ, in the direction in which they differ most."""
    ratio = np.linalg.eigvals(np.linalg.solve(other, covariance)).real
    return float(np.abs(np.sqrt(ratio) - 1).max())


@pytest.mark.parametrize("seed", range(4))
def test_the_estimate_is_the_exact_one(seed: int) -> None:
    world = make_world(seed)
    graph, exact = graph_of(world), solve(world)
    difference = se2.between(exact.poses, graph.keyframe_poses(7))
    np.testing.assert_allclose(difference[:, :2], 0.0, atol=2e-3)
    np.testing.assert_allclose(difference[:, 2], 0.0, atol=1e-3)
    walls = se2.between(graph.wall_frames(range(5)), exact.walls)
    np.testing.assert_allclose(walls[:, 1] - walls[:, 0] * np.tan(walls[:, 2]), 0.0, atol=2e-3)
    np.testing.assert_allclose(walls[:, 2], 0.0, atol=1e-3)
    np.testing.assert_allclose(graph.corner_positions(range(3)), exact.corners, atol=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_covariances_are_the_exact_ones(seed: int) -> None:
    world = make_world(seed, SILENT)
    graph = graph_of(world, strays=0.0)
    exact = solve(world)
    at = replace(exact, walls=graph.wall_frames(range(5)))  # wherever along the walls its frames stand
    jacobian = jacobian_of(at, world, True)
    # where nothing scatters the kernel takes no weight, and what it takes otherwise is corrected for all the same
    exact = replace(at, information=jacobian.T @ jacobian / ROBUST_COVARIANCE_SCALE)
    shares = [apart(graph.keyframe_covariance(k), exact.covariance(3 * k, 3)) for k in range(1, 7)]
    shares += [apart(graph.wall_covariance(j), exact.covariance(21 + 2 * j, 2)) for j in range(5)]
    shares += [apart(graph.corner_covariance(j), exact.covariance(31 + 2 * j, 2)) for j in range(3)]
    assert np.mean(shares) < 0.04
    assert max(shares) < 0.15


def test_the_kernels_caution_is_that_of_honest_observations() -> None:
    """By drawing them: what the kernel's estimate of a point scatters by, and what its Hessian claims."""
    random, scale = np.random.default_rng(0), CAUCHY_SCALE**2
    drawn = random.normal(size=(4000, 100, 2))
    estimate = np.zeros((4000, 1, 2))
    for _ in range(10):
        weight = 1 / (1 + ((drawn - estimate) ** 2).sum(axis=-1, keepdims=True) / scale)
        estimate = (weight * drawn).sum(axis=1, keepdims=True) / weight.sum(axis=1, keepdims=True)
    assert (estimate**2).mean() / (1 / weight.sum(axis=1)).mean() == pytest.approx(ROBUST_COVARIANCE_SCALE, rel=0.04)


def test_relative_covariances_are_those_of_a_map_that_begins_at_the_keyframe() -> None:
    world = make_world(1, SILENT)
    graph, last = graph_of(world, strays=0.0), 6
    state = replace(solve(world), walls=graph.wall_frames(range(5)))
    jacobian = jacobian_of(state, world, prior=False)
    free = np.r_[0 : 3 * last, 3 * last + 3 : jacobian.shape[1]]  # the keyframe does not move, nothing else is given
    covariance = np.linalg.inv(jacobian[:, free].T @ jacobian[:, free])
    own, walls, corners, *_ = graph.relative_covariances(last, range(5), range(3))
    for j in range(5):
        at = slice(18 + 2 * j, 20 + 2 * j)
        assert apart(walls[j], covariance[at, at]) < 0.2
    for j in range(3):
        at = slice(28 + 2 * j, 30 + 2 * j)
        assert apart(corners[j], covariance[at, at]) < 0.2
    pose = graph.keyframe_pose(last)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        own, turn @ graph.keyframe_covariance(last) @ turn.T / ROBUST_COVARIANCE_SCALE, rtol=1e-6, atol=1e-12
    )


def test_between_keyframes_of_a_chain_only_the_motions_between_them_are_uncertain() -> None:
    graph, pose, motion = FactorGraph(), np.zeros(3), np.array([0.5, 0.1, 0.3])
    graph.add_first_keyframe(pose)
    for k in range(1, 7):
        pose = se2.compose(pose, motion)
        graph.add_keyframe(k, pose, k - 1, motion, ODOMETRY)
    graph.update()
    expected = np.zeros((3, 3))
    for _ in range(3):
        carry = se2.adjoint(se2.inverse(motion))
        expected = carry @ expected @ carry.T + ODOMETRY
    np.testing.assert_allclose(
        graph.relative_covariance(2, 5), ROBUST_COVARIANCE_SCALE * expected, rtol=1e-6, atol=1e-12
    )


def two_frames_on_one_wall() -> FactorGraph:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    covariance = np.diag([0.01, 0.01]) ** 2
    for wall, frame in enumerate(([1.0, -1.0, 0.01], [2.5, -1.02, -0.01], [3.0, 0.0, 1.57])):
        graph.add_wall(0, wall, np.array(frame), np.array(frame))
        graph.observe_wall(0, wall, np.array(frame), covariance, np.array(frame))
    graph.update()
    return graph


def test_tied_walls_come_together() -> None:
    graph = two_frames_on_one_wall()
    first, second, third = graph.wall_frames(range(3))
    graph.tie_walls(0, 1, 1.5)
    graph.update()
    graph.settle()
    one, other, unmoved = graph.wall_frames(range(3))
    between = se2.between(one, other)
    assert np.abs(between[1:]).max() < 2e-3
    assert abs(se2.between(first, second)[1]) > 0.02
    np.testing.assert_allclose(unmoved, third, atol=1e-6)
    assert min(first[1], second[1]) < one[1] < max(first[1], second[1])


def test_settling_twice_changes_next_to_nothing() -> None:
    graph = graph_of(make_world(5))
    poses, walls = graph.keyframe_poses(7), graph.wall_frames(range(5))
    graph.settle()
    np.testing.assert_allclose(graph.keyframe_poses(7), poses, atol=2e-4)
    np.testing.assert_allclose(graph.wall_frames(range(5)), walls, atol=2e-4)


def test_what_is_undetermined_is_an_error() -> None:
    graph = FactorGraph()
    graph.add_first_keyframe(np.zeros(3))
    graph.add_wall(0, 0, np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    with pytest.raises(MapError, match="the map cannot be estimated"):
        graph.update()


def test_qr_goes_on_where_cholesky_gave_up() -> None:
    world = make_world(1)
    cholesky, qr = graph_of(world), graph_of(world)
    for graph in (cholesky, qr):
        graph.remove_factors(graph.close_loop(0, 6, se2.between(world.poses[0], world.poses[6]), np.full(3, 0.01)))
    qr._factorize_by_qr(RuntimeError("Indeterminate linear system"))
    for graph in (cholesky, qr):  # and it knows its observations
        graph.forget_observations([0, 2], since=4)
        seen = se2.between(world.poses[5], world.walls[0])
        graph.observe_wall(5, 0, seen, np.diag([1e-4, 1e-5]), seen)
        graph.update()
        graph.rebuild()
    assert qr.factor_count == cholesky.factor_count
    np.testing.assert_allclose(qr.keyframe_poses(7), cholesky.keyframe_poses(7), atol=1e-6)
    np.testing.assert_allclose(qr.keyframe_covariance(6), cholesky.keyframe_covariance(6), rtol=1e-4)
    with pytest.raises(MapError, match="Indeterminate"):
        qr._factorize_by_qr(RuntimeError("Indeterminate linear system"))


class Choking:
    """An ISAM2 that cannot answer."""

    def __init__(self, isam: gtsam.ISAM2) -> None:
        self._isam = isam

    def __getattr__(self, name: str) -> Any:
        return getattr(self._isam, name)

    def marginalCovariance(self, key: int) -> None:  # noqa: N802
        raise RuntimeError("Indeterminate linear system")

    def jointMarginalCovariance(self, keys: Sequence[int]) -> None:  # noqa: N802
        raise RuntimeError("Indeterminate linear system")


@pytest.mark.parametrize("ask", [lambda g: g.keyframe_covariance(6), lambda g: g.relative_covariance(0, 6)])
def test_qr_answers_what_cholesky_cannot(ask: Callable[[FactorGraph], np.ndarray]) -> None:
    graph = graph_of(make_world(1))
    before = ask(graph)
    graph._isam = Choking(graph._isam)
    np.testing.assert_allclose(ask(graph), before, rtol=1e-4, atol=1e-12)
    graph._isam = Choking(graph._isam)
    with pytest.raises(MapError, match="Indeterminate"):
        ask(graph)


def test_one_wrong_view_does_not_bend_the_map() -> None:
    world = make_world(2)
    graph = graph_of(world)
    before = graph.keyframe_poses(7)
    believed = se2.between(before[3], world.walls[1])
    graph.observe_wall(3, 1, se2.compose(believed, [0.0, 0.5, 0.2]), np.eye(2) * 1e-5, believed)
    graph.update()
    graph.settle()
    np.testing.assert_allclose(graph.keyframe_poses(7), before, atol=3e-3)


@pytest.mark.parametrize("seed", range(4))
def test_solving_in_batch_finds_what_solving_step_by_step_does(seed: int) -> None:
    world = make_world(seed)
    step_by_step, batch = graph_of(world), graph_of(world, batch=True)
    step_by_step.rebuild()
    assert batch.factor_count == step_by_step.factor_count
    assert batch.chi2() == pytest.approx(step_by_step.chi2(), rel=1e-6)
    count = len(world.poses)
    np.testing.assert_allclose(batch.keyframe_poses(count), step_by_step.keyframe_poses(count), atol=1e-5)
    for k in range(1, count):
        expected = step_by_step.keyframe_covariance(k)
        np.testing.assert_allclose(batch.keyframe_covariance(k), expected, rtol=1e-2, atol=1e-9)
