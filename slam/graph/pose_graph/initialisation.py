"""A start for the optimiser that needs no estimate: headings first, then positions.

Headings by chordal relaxation (Martinec and Pajdla 2007; Carlone et al. 2015): with the headings as complex numbers u,

    minimise  sum of w |u_j - u_i exp(i theta_z)|^2

is linear where the u need not have length one; their angles are the headings. The weight w is what the measurement
says of the heading alone: the information left when the translation is unknown, a Schur complement. With the headings
known, the errors of motions and positions are linear in what is left, so one step of least squares finds it, under the
full information matrices.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from .least_squares import CHOLESKY_LIKE, NormalEquations, variables_of, with_variables
from .model import Flags, Floats, PoseGraph
from .placing import intersect_bearings
from .solver import minimise

HELD = 1e-9
"""Weight, as a share of the largest, that ties each heading to the one it has, lest no measurement tells it."""


def initialise(graph: PoseGraph, free: Flags) -> Floats:
    """Variables (3 n + 2 m,) near the optimum, of which only the `free` ones differ from the graph's estimate."""
    size = graph.poses.size
    turning = free[:size].reshape(-1, 3)[:, 2]
    turned = graph.poses.copy()
    turned[turning, 2] = chordal_headings(graph, ~turning)[turning]
    straight = graph.with_estimate(turned, graph.landmarks)
    moving = free.copy()
    moving[:size].reshape(-1, 3)[:, 2] = False
    if len(graph.bearings):  # not linear: landmarks that have nothing else are put where their bearings meet
        blind = np.ones(len(graph.landmarks), dtype=bool)
        blind[graph.positions.target] = False
        blind &= free[size::2]
        linear = straight.select_edges(np.arange(graph.edge_count) < graph.edge_count - len(graph.bearings))
        linear = with_variables(linear, minimise(linear, NormalEquations(linear, moving), variables_of(linear))[0])
        met = intersect_bearings(replace(linear, bearings=graph.bearings))
        straight = straight.with_estimate(linear.poses, np.where(blind[:, None], met, linear.landmarks))
    return minimise(straight, NormalEquations(straight, moving), variables_of(straight))[0]


def chordal_headings(graph: PoseGraph, known: Flags) -> Floats:
    """(n,): headings that agree with the motions, given those that are `known` (n,)."""
    motions, count = graph.motions, len(graph.poses)
    weight = _heading_information(motions.information)
    turn = np.exp(1j * motions.measured[:, 2])
    i, j = motions.source, motions.target
    ones = weight.astype(complex)
    matrix = coo_array(
        (
            np.concatenate([ones, ones, -weight * turn.conj(), -weight * turn]),
            (np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])),
        ),
        shape=(count, count),
    ).tocsc()
    held = HELD * weight.max(initial=1e-300)
    present = np.exp(1j * graph.poses[:, 2])
    unknown = ~known
    right = held * present - matrix[:, known] @ present[known]
    matrix = (matrix + held * diags_array(np.ones(count))).tocsc()[unknown][:, unknown]
    found = present.copy()
    found[unknown] = splu(csc_array(matrix), permc_spec="MMD_AT_PLUS_A", **CHOLESKY_LIKE).solve(right[unknown])
    return np.asarray(np.angle(found))


def _heading_information(information: Floats) -> Floats:
    """(k,): what the matrices (k, 3, 3) say of the heading when nothing is known of the translation."""
    across = information[:, :2, 2]
    explained = (np.linalg.pinv(information[:, :2, :2], hermitian=True) @ across[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(information[:, 2, 2] - (across * explained).sum(axis=1), 0.0))
