"""Optimisation of pose graphs: Jacobians, known optima, gauges, false edges, and the command `wclm optimize`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from slam.graph.pose_graph import Edges, PoseGraph, odometry_edges, optimise, read_pose_graph, write_g2o
from slam.graph.pose_graph.edge_errors import bearing_errors, motion_errors, position_errors
from slam.graph.pose_graph.initialisation import chordal_headings, initialise
from slam.graph.pose_graph.least_squares import NormalEquations, edge_chi2, variables_of
from slam.graph.pose_graph.optimise import free_variables

NO_LINE = np.zeros(0, dtype=np.int64)


def edges(source: Any, target: Any, measured: Any, information: Any) -> Edges:
    measured = np.asarray(measured, float)
    k, d = measured.shape
    information = np.broadcast_to(np.asarray(information, float), (k, d, d)).copy()
    return Edges(np.asarray(source, int), np.asarray(target, int), measured, information, np.zeros(k, int))


def no_edges(size: int) -> Edges:
    return edges(NO_LINE, NO_LINE, np.zeros((0, size)), np.eye(size))


def square_laps(
    seed: int, sigmas: tuple[float, float, float] = (0.02, 0.02, 0.01), laps: int = 4
) -> tuple[PoseGraph, np.ndarray]:
    """Return a graph of laps around a square of 10 m, with loop edges to the lap before, and the true poses."""
    generator = np.random.default_rng(seed)
    side = np.linspace(0, 10, 10, endpoint=False)
    corner = [(0, 0, 0), (10, 0, np.pi / 2), (10, 10, np.pi), (0, 10, -np.pi / 2)]
    lap = np.concatenate([se2.compose(np.array(c), np.stack([side, 0 * side, 0 * side], axis=-1)) for c in corner])
    truth = np.tile(lap, (laps, 1))
    step = np.arange(len(truth) - 1)
    again = np.arange(len(truth) - 40)
    source, target = np.concatenate([step, again]), np.concatenate([step + 1, again + 40])
    noise = np.array(sigmas)
    measured = se2.compose(se2.between(truth[source], truth[target]), generator.normal(0, noise, (len(source), 3)))
    poses = [truth[0]]
    for k in step:
        poses.append(se2.compose(poses[-1], measured[k]))
    graph = PoseGraph(
        pose_ids=np.arange(len(truth)) * 3 + 5,
        poses=np.array(poses),
        landmark_ids=np.zeros(0, int),
        landmarks=np.zeros((0, 2)),
        motions=edges(source, target, measured, np.diag(1 / noise**2)),
        positions=no_edges(2),
        bearings=no_edges(1),
        fixed_poses=np.zeros(len(truth), bool),
        fixed_landmarks=np.zeros(0, bool),
    )
    return graph, truth


def with_landmarks(graph: PoseGraph, truth: np.ndarray, seed: int) -> tuple[PoseGraph, np.ndarray]:
    """Return the graph with five landmarks, four measured by position, three by bearing, and their true positions."""
    generator = np.random.default_rng(seed)
    points = np.array([[5.0, 5], [2, 3], [8, 6], [-3, 4], [12, -2]])
    pose = np.repeat(np.arange(0, len(truth), 3), 5)
    observed = np.tile(np.arange(5), len(pose) // 5)
    local = se2.transform(se2.inverse(truth[pose]), points[observed])
    near, far = observed < 4, observed > 1
    positions = local[near] + generator.normal(0, 0.05, (near.sum(), 2))
    bearing = np.arctan2(local[far, 1], local[far, 0])[:, None] + generator.normal(0, 0.01, (far.sum(), 1))
    landmarks = replace(
        graph,
        landmark_ids=np.arange(5),
        landmarks=points + generator.normal(0, 1, points.shape),
        positions=edges(pose[near], observed[near], positions, np.eye(2) / 0.05**2),
        bearings=edges(pose[far], observed[far], bearing, [[1e4]]),
        fixed_landmarks=np.zeros(5, bool),
    )
    return landmarks, points


@pytest.mark.parametrize(
    ("errors", "size", "variables"), [(motion_errors, 3, 6), (position_errors, 2, 5), (bearing_errors, 1, 5)]
)
def test_jacobians_equal_finite_differences(errors: Any, size: int, variables: int) -> None:
    generator = np.random.default_rng(1)
    at, measured = generator.normal(0, 2, (50, variables)), generator.normal(0, 2, (50, size))
    jacobian = errors(at, measured)[1]
    for k, unit in enumerate(np.eye(variables)):
        difference = errors(at + 1e-6 * unit, measured)[0] - errors(at - 1e-6 * unit, measured)[0]
        np.testing.assert_allclose(jacobian[:, :, k], se2.wrap(difference) / 2e-6, atol=1e-6, rtol=1e-5)


def test_motion_error_is_the_pose_relative_to_the_measured_one() -> None:
    generator = np.random.default_rng(2)
    first, second, measured = generator.normal(0, 2, (3, 20, 3))
    error, _ = motion_errors(np.hstack([first, second]), measured)
    np.testing.assert_allclose(error, se2.between(measured, se2.between(first, second)), atol=1e-12)


def test_gradient_is_that_of_chi2() -> None:
    graph, _ = with_landmarks(*square_laps(0), seed=0)
    free = free_variables(graph)
    equations = NormalEquations(graph, free)
    x, weights = variables_of(graph), np.random.default_rng(0).uniform(0, 1, graph.edge_count)
    _, gradient = equations.linearise(x, weights)
    change = np.random.default_rng(1).normal(0, 1e-6, equations.size)
    ahead, behind = equations.apply_step(x, change), equations.apply_step(x, -change)
    difference = weights @ (edge_chi2(graph, ahead) - edge_chi2(graph, behind))
    assert difference == pytest.approx(4 * gradient @ change, rel=1e-5)
    assert (ahead[~free] == x[~free]).all()


def test_exact_measurements_are_satisfied_from_any_initial_estimate() -> None:
    graph, truth = square_laps(0, sigmas=(1e-9, 1e-9, 1e-9))
    graph, points = with_landmarks(graph, truth, seed=0)
    local = se2.transform(se2.inverse(truth[graph.positions.source]), points[graph.positions.target])
    graph = replace(graph, positions=replace(graph.positions, measured=local), bearings=no_edges(1))
    initial = np.random.default_rng(3).uniform(-9, 9, truth.shape)
    initial[0] = truth[0]
    found = optimise(graph.with_estimate(initial, 100 * points)).graph
    np.testing.assert_allclose(found.poses[:, :2], truth[:, :2], atol=1e-6)
    np.testing.assert_allclose(se2.wrap(found.poses[:, 2] - truth[:, 2]), 0, atol=1e-6)
    observed = np.unique(graph.positions.target)
    np.testing.assert_allclose(found.landmarks[observed], points[observed], atol=1e-6)


def test_chi2_at_the_optimum_has_the_expected_distribution() -> None:
    """Its expectation is the number of degrees of freedom, its variance twice that."""
    graph, truth = square_laps(4)
    graph, _ = with_landmarks(graph, truth, seed=4)
    result = optimise(graph)
    freedom = sum(kind.measured.size for kind in graph.edges_by_kind) - free_variables(graph).sum()
    assert abs(result.chi2 - freedom) < 4 * np.sqrt(2 * freedom)
    assert result.chi2 < result.chi2_before
    assert np.hypot(*(result.graph.poses - truth)[:, :2].T).max() < 0.3


def test_optimum_of_two_measurements_is_the_weighted_mean() -> None:
    measured = [[1.0, 0, 0.0], [2.0, 0, 0.3]]
    information = [np.diag([1.0, 1, 1]), np.diag([3.0, 1, 2])]
    graph, _ = square_laps(0)
    pair = replace(
        graph,
        pose_ids=np.arange(2),
        poses=np.array([[0, 0, 0], [9.0, 9, 2]]),
        motions=edges([0, 0], [1, 1], measured, information),
        fixed_poses=np.zeros(2, bool),
    )
    expected = [0.0, 0.0, 0.2]  # of x and y it is found on a grid: the frames of the motions differ
    found = optimise(pair)
    x = np.linspace(0.9, 2.1, 2401)
    y = np.linspace(-0.3, 0.3, 1201)
    turned = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    second = (grid - [2.0, 0.0]) @ turned.T
    cost = ((grid - [1.0, 0.0]) ** 2).sum(axis=-1) + 3 * second[..., 0] ** 2 + second[..., 1] ** 2
    best = np.unravel_index(cost.argmin(), cost.shape)
    np.testing.assert_allclose(found.graph.poses[1, :2], [x[best[0]], y[best[1]]], atol=1e-3)
    assert found.graph.poses[1, 2] == pytest.approx(expected[2], abs=1e-9)


def test_chordal_headings_do_not_depend_on_the_initial_estimate() -> None:
    graph, truth = square_laps(5)
    known = np.arange(len(truth)) == 0
    initial = graph.poses.copy()
    initial[1:, 2] = np.random.default_rng(0).uniform(-3, 3, len(initial) - 1)
    headings = chordal_headings(graph.with_estimate(initial, graph.landmarks), known)
    assert np.abs(se2.wrap(headings - truth[:, 2])).max() < 0.1


def test_motions_without_heading_information_are_supported() -> None:
    graph, _ = square_laps(6)
    information = graph.motions.information.copy()
    information[:, 2, 2] = 0.0
    blind = replace(graph, motions=replace(graph.motions, information=information))
    x = initialise(blind, free_variables(blind))
    assert np.isfinite(x).all()
    result = optimise(blind)
    assert np.isfinite(result.graph.poses).all()
    assert result.chi2 <= result.chi2_before


def test_fixed_vertices_and_one_pose_of_each_component_do_not_move() -> None:
    graph, truth = square_laps(7)
    fixed = np.isin(np.arange(len(truth)), [50, 90])
    result = optimise(replace(graph, fixed_poses=fixed)).graph
    np.testing.assert_allclose(result.poses[fixed, :2], graph.poses[fixed, :2], atol=1e-12)
    assert np.abs(result.poses[0] - graph.poses[0]).max() > 1e-3
    second = replace(graph.motions, source=graph.motions.source + 160, target=graph.motions.target + 160)
    both = Edges(*(np.concatenate([getattr(e, n) for e in (graph.motions, second)]) for n in Edges.__slots__))
    two = replace(
        graph,
        pose_ids=np.arange(320),
        poses=np.concatenate([graph.poses, graph.poses + np.array([50, 0, 0])]),
        motions=both,
        fixed_poses=np.zeros(320, bool),
    )
    found = optimise(two)
    np.testing.assert_allclose(found.graph.poses[[0, 160]], two.poses[[0, 160]], atol=1e-12)
    assert found.chi2 == pytest.approx(2 * optimise(graph).chi2, rel=1e-6)


def test_odometry_is_the_first_edge_between_successive_ids() -> None:
    graph, _ = square_laps(0)
    ids = np.array([30, 10, 20])
    small = replace(
        graph,
        pose_ids=ids,
        poses=np.zeros((3, 3)),
        motions=edges([1, 2, 1, 0, 1], [2, 1, 0, 2, 2], np.ones((5, 3)), np.eye(3)),
        fixed_poses=np.zeros(3, bool),
    )
    assert odometry_edges(small).tolist() == [True, False, False, True, False]


def add_false_loops(graph: PoseGraph, share: float, seed: int) -> tuple[PoseGraph, np.ndarray]:
    """Return the graph with false edges, a share of the number of its loop edges, and a mask of them."""
    generator = np.random.default_rng(seed)
    motions, poses = graph.motions, len(graph.poses)
    loops = np.flatnonzero(np.abs(motions.target - motions.source) != 1)
    count = round(share * len(loops))
    source = generator.integers(0, poses, count)
    target = (source + generator.integers(2, poses - 2, count)) % poses
    false = edges(
        source,
        target,
        np.column_stack([generator.uniform(-10, 10, (count, 2)), generator.uniform(-np.pi, np.pi, count)]),
        np.eye(3),
    )
    false = replace(false, information=motions.information[generator.choice(loops, count)])
    both = Edges(*(np.concatenate([getattr(motions, n), getattr(false, n)]) for n in Edges.__slots__))
    return replace(graph, motions=both), np.arange(graph.edge_count + count) >= graph.edge_count


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_false_edges_are_rejected(seed: int) -> None:
    graph, _ = square_laps(seed, sigmas=(0.05, 0.05, 0.02))
    corrupted, false = add_false_loops(graph, 0.5, seed)
    result = optimise(corrupted, robust=True)
    assert (result.inliers == ~false).all()
    assert result.chi2 == pytest.approx(optimise(graph).chi2, rel=1e-6)
    assert optimise(corrupted).chi2 > 100 * result.chi2


def test_no_true_edge_is_rejected() -> None:
    graph, _ = with_landmarks(*square_laps(8), seed=8)
    result = optimise(graph, robust=True)
    assert result.inliers.all()
    assert result.chi2 == pytest.approx(optimise(graph).chi2, rel=1e-6)


def test_false_landmark_observations_are_rejected() -> None:
    graph, _ = with_landmarks(*square_laps(9), seed=9)
    measured = graph.positions.measured.copy()
    measured[::15] += [3.0, -2.0]
    result = optimise(replace(graph, positions=replace(graph.positions, measured=measured)), robust=True)
    false = np.zeros(graph.edge_count, bool)
    false[len(graph.motions) : len(graph.motions) + len(measured) : 15] = True
    assert (result.inliers == ~false).all()


# --- the command


@pytest.mark.slow
def test_optimize_writes_a_graph_and_a_summary(wclm: Any, tmp_path: Path) -> None:
    graph, _ = with_landmarks(*square_laps(1), seed=1)
    corrupted, false = add_false_loops(replace(graph, landmark_ids=np.arange(5) + 10_000), 0.3, 1)
    write_g2o(tmp_path / "a.g2o", corrupted)
    result = wclm("optimize", "a.g2o", "--out", "out", "--robust", "--plot")
    assert result.exit_code == 0, result.output
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["graph.g2o", "graph.png", "summary.json"]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["poses"], summary["landmarks"]) == (160, 5)
    assert (summary["edges"], len(summary["rejected"])) == (corrupted.edge_count, false.sum())
    lines = (tmp_path / "a.g2o").read_text().splitlines()
    for edge in summary["rejected"]:
        assert lines[edge["line"] - 1].startswith(f"{edge['tag']} {edge['from']} {edge['to']} ")
    written = read_pose_graph(tmp_path / "out" / "graph.g2o").graph
    assert edge_chi2(written, variables_of(written)).sum() == pytest.approx(summary["chi2_after"])
    assert written.edge_count == corrupted.edge_count - false.sum()
    for words in (
        "a.g2o: 160 poses, 5 landmarks",
        "before     chi2",
        "after      chi2",
        f"rejected   {false.sum()} edges",
    ):
        assert words in result.stdout
    wclm.refuses("optimize", "a.g2o", "--out", "out", because=["out: exists already"])
    assert wclm("optimize", "a.g2o", "--out", "out", "--overwrite").exit_code == 0
    assert not (tmp_path / "out" / "graph.png").exists()


@pytest.mark.parametrize(("x", "information"), [("1e200", "1"), ("1e300", "1"), ("1", "1e308")])
def test_optimize_refuses_graphs_without_a_finite_optimum(wclm: Any, tmp_path: Path, x: str, information: str) -> None:
    entries = f"{information} 0 0 {information} 0 {information}"
    vertices = [f"VERTEX_SE2 {k} {k * float(x):g} 0 0" for k in range(3)]
    edges = [f"EDGE_SE2 0 1 3 0 0 {entries}", f"EDGE_SE2 1 2 -{x} 0 0 {entries}", f"EDGE_SE2 0 2 -5 7 1 {entries}"]
    (tmp_path / "a.g2o").write_text("\n".join([*vertices, *edges, ""]))
    wclm.refuses("optimize", "a.g2o", "--out", "out", because=["a.g2o: its numbers are so large that it has no finite"])
    assert not (tmp_path / "out").exists()


def test_optimize_refuses_files_that_are_not_pose_graphs(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "a.graph").write_text("EDGE2 0 1 1 0 0 1 0 1 1 0 0\nEDGE2 1 2 x 0 0 1 0 1 1 0 0\n")
    wclm.refuses("optimize", "a.graph", "--out", "out", because=["a.graph:2: x is not a number"])
    wclm.refuses("optimize", "none.g2o", "--out", "out", because=["none.g2o: No such file"])
    wclm.refuses("optimize", "a.txt", "--out", "out", because=["a.txt: no such file"])
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.graph"]
