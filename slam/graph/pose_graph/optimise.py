"""Optimise a pose graph: from its own estimate and from a rotation-first start, the better optimum wins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .initialisation import initialise
from .least_squares import NormalEquations, edge_chi2, variables_of, with_variables
from .model import Flags, PoseGraph
from .placing import components
from .robust import solve_robustly
from .solver import minimise


@dataclass(frozen=True, slots=True, eq=False)
class Optimised:
    """An optimised graph."""

    graph: PoseGraph
    """At the optimum, with the edges that are believed."""
    kept: Flags
    """(edge_count of the graph that was given,): which these are."""
    chi2_before: float
    """Of all edges, at the estimate that was given."""
    chi2: float
    """Of the edges that are believed, at the optimum."""


def optimise(graph: PoseGraph, robust: bool = False) -> Optimised:
    """Find the estimate with the least chi2; with `robust` leave out edges that contradict the others.

    A connected part of the graph with no fixed vertex is held where its first pose is.
    """
    free = free_variables(graph)
    given = variables_of(graph)
    before = float(edge_chi2(graph, given).sum())
    if robust:
        x, kept = solve_robustly(graph, free)
        found = with_variables(graph.select_edges(kept), x)
    else:
        equations = NormalEquations(graph, free)
        solutions = [minimise(graph, equations, start) for start in (given, initialise(graph, free))]
        x, _ = min(solutions, key=lambda solution: solution[1])
        kept, found = np.ones(graph.edge_count, dtype=bool), with_variables(graph, x)
    return Optimised(found, kept, before, float(edge_chi2(found, variables_of(found)).sum()))


def free_variables(graph: PoseGraph) -> Flags:
    """(3 n + 2 m,): which variables may move.

    Not those of fixed vertices, nor, in each connected part without any, those of its first pose.
    """
    part = components(graph)
    fixed = np.concatenate([graph.fixed_poses, graph.fixed_landmarks])
    poses = len(graph.poses)
    of_part, first = np.unique(part[:poses], return_index=True)
    loose = ~np.isin(of_part, part[fixed])
    fixed[first[loose]] = True
    return ~np.concatenate([np.repeat(fixed[:poses], 3), np.repeat(fixed[poses:], 2)])
