"""Public pose graphs, if available, compared with their best known optima."""

from __future__ import annotations

import numpy as np
import pytest

from slam.graph.pose_graph import Edges, PoseGraph, optimise, read_pose_graph
from slam.graph.pose_graph.least_squares import edge_chi2, variables_of

from ...recordings import dataset_file

OPTIMA = {"intel-1228": 215.83, "mitb-808": 41.163, "m3500": 137.913, "intel-1728": 45.005, "csail-1045": 40.555}


def load_graph(name: str) -> PoseGraph:
    return read_pose_graph(dataset_file(f"g2o/{name}.g2o")).graph


@pytest.mark.parametrize("name", OPTIMA)
def test_best_known_optimum_is_reached(name: str) -> None:
    assert optimise(load_graph(name)).chi2 == pytest.approx(OPTIMA[name], rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIMA)
def test_no_true_edge_is_rejected(name: str) -> None:
    assert optimise(load_graph(name), robust=True).chi2 == pytest.approx(OPTIMA[name], rel=0.005)


def check_false_loops(name: str, seed: int) -> None:
    """Add random false edges, 30 % of the number of loop edges, with the information of loop edges."""
    graph = load_graph(name)
    motions, poses = graph.motions, len(graph.poses)
    generator = np.random.default_rng(seed)
    loops = np.flatnonzero(np.abs(motions.target - motions.source) != 1)
    count = round(0.3 * len(loops))
    source = generator.integers(0, poses, count)
    target = (source + generator.integers(2, poses - 2, count)) % poses
    wrong = np.column_stack([generator.uniform(-10, 10, (count, 2)), generator.uniform(-np.pi, np.pi, count)])
    corrupted = Edges(
        source=np.concatenate([motions.source, source]),
        target=np.concatenate([motions.target, target]),
        measured=np.concatenate([motions.measured, wrong]),
        information=np.concatenate([motions.information, motions.information[generator.choice(loops, count)]]),
        line=np.zeros(len(motions) + count, dtype=np.int64),
    )
    result = optimise(
        PoseGraph(**{n: getattr(graph, n) for n in PoseGraph.__slots__} | {"motions": corrupted}), robust=True
    )
    false, outliers = np.arange(len(motions) + count) >= len(motions), ~result.inliers
    assert (outliers & false).sum() >= 0.98 * outliers.sum()
    assert (outliers & false).sum() >= 0.98 * count
    found = graph.with_estimate(result.graph.poses, result.graph.landmarks)
    assert edge_chi2(found, variables_of(found)).sum() == pytest.approx(OPTIMA[name], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", ["m3500", "intel-1728"])
def test_false_loops_are_rejected(name: str, seed: int) -> None:
    check_false_loops(name, seed)
