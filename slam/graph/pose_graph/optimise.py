"""Optimise a pose graph from two initial estimates, its own and a chordal one, and take the better optimum."""

from __future__ import annotations

import numpy as np

from drivers.immutable import immutable

from .initialisation import initialise
from .least_squares import NormalEquations, edge_chi2, variables_of, with_variables
from .levenberg_marquardt import minimise
from .model import Flags, PoseGraph
from .robust import solve_robustly
from .spanning_tree import components


@immutable
class OptimisedGraph:
    """An optimised graph."""

    graph: PoseGraph
    """At the optimum, with its inlier edges only."""
    inliers: Flags
    """(edge_count of the input graph,): true for its inlier edges."""
    chi2_before: float
    """Of all edges, at the input estimate."""
    chi2: float
    """Of the inlier edges, at the optimum."""


def optimise(graph: PoseGraph, robust: bool = False) -> OptimisedGraph:
    """Find the estimate with the least chi2; if `robust`, without edges that contradict the others.

    In each connected component without a fixed vertex the first pose is fixed.
    """
    free = free_variables(graph)
    initial = variables_of(graph)
    before = float(edge_chi2(graph, initial).sum())
    if robust:
        x, inliers = solve_robustly(graph, free)
        optimum = with_variables(graph.select_edges(inliers), x)
    else:
        equations = NormalEquations(graph, free)
        solutions = [minimise(graph, equations, start) for start in (initial, initialise(graph, free))]
        x, _ = min(solutions, key=lambda solution: solution[1])
        inliers, optimum = np.ones(graph.edge_count, dtype=bool), with_variables(graph, x)
    return OptimisedGraph(optimum, inliers, before, float(edge_chi2(optimum, variables_of(optimum)).sum()))


def free_variables(graph: PoseGraph) -> Flags:
    """Return a mask (3 n + 2 m,) of the variables that may change.

    Fixed are those of fixed vertices and, in each connected component without any, those of its first pose.
    """
    component = components(graph)
    fixed = np.concatenate([graph.fixed_poses, graph.fixed_landmarks])
    poses = len(graph.poses)
    index, first = np.unique(component[:poses], return_index=True)
    unconstrained = ~np.isin(index, component[fixed])
    fixed[first[unconstrained]] = True
    return ~np.concatenate([np.repeat(fixed[:poses], 3), np.repeat(fixed[poses:], 2)])
