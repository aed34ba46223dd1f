"""Initial estimate for the optimiser that needs no prior estimate: headings first, then positions.

Headings by chordal relaxation (Martinec and Pajdla 2007; Carlone et al. 2015): with the headings as complex numbers u,

    minimise  sum of w |u_j - u_i exp(i theta_z)|^2

is linear if the u need not have length one; their angles are the headings. The weight w is the measurement's
information on the heading with the translation marginalised out, a Schur complement. With the headings fixed, the
errors of motions and positions are linear in the positions, so one least-squares step with the full information
matrices solves them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from ...geometry.segments import Floats
from .least_squares import CHOLESKY_LIKE, NormalEquations, variables_of, with_variables
from .levenberg_marquardt import minimise
from .model import Flags, PoseGraph
from .spanning_tree import intersect_bearings

# Weight of each pose's present heading relative to the largest weight, so that unmeasured headings are determined.
# Origin: numerical.
PRIOR_WEIGHT = 1e-9


def initialise(graph: PoseGraph, free: Flags) -> Floats:
    """Return variables (3 n + 2 m,) near the optimum; only the `free` ones differ from the graph's estimate."""
    size = graph.poses.size
    free_heading = free[:size].reshape(-1, 3)[:, 2]
    poses = graph.poses.copy()
    poses[free_heading, 2] = chordal_headings(graph, ~free_heading)[free_heading]
    with_headings = graph.with_estimate(poses, graph.landmarks)
    free_position = free.copy()
    free_position[:size].reshape(-1, 3)[:, 2] = False
    if len(graph.bearings):  # not linear: landmarks without positions are placed at the intersection of their bearings
        bearing_only = np.ones(len(graph.landmarks), dtype=bool)
        bearing_only[graph.positions.target] = False
        bearing_only &= free[size::2]
        linear = with_headings.select_edges(np.arange(graph.edge_count) < graph.edge_count - len(graph.bearings))
        optimum, _ = minimise(linear, NormalEquations(linear, free_position), variables_of(linear))
        linear = with_variables(linear, optimum)
        intersections = intersect_bearings(replace(linear, bearings=graph.bearings))
        landmarks = np.where(bearing_only[:, None], intersections, linear.landmarks)
        with_headings = with_headings.with_estimate(linear.poses, landmarks)
    return minimise(with_headings, NormalEquations(with_headings, free_position), variables_of(with_headings))[0]


def chordal_headings(graph: PoseGraph, known: Flags) -> Floats:
    """Return headings (n,) by chordal relaxation of the motions, given those that are `known` (n,)."""
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
    prior = PRIOR_WEIGHT * weight.max(initial=1e-300)
    present = np.exp(1j * graph.poses[:, 2])
    unknown = ~known
    right = prior * present - matrix[:, known] @ present[known]
    matrix = (matrix + prior * diags_array(np.ones(count))).tocsc()[unknown][:, unknown]
    solved = present.copy()
    solved[unknown] = splu(csc_array(matrix), permc_spec="MMD_AT_PLUS_A", **CHOLESKY_LIKE).solve(right[unknown])
    return np.asarray(np.angle(solved))


def _heading_information(information: Floats) -> Floats:
    """Return the information (k,) on the heading with the translation marginalised out of (k, 3, 3)."""
    cross = information[:, :2, 2]
    gain = (np.linalg.pinv(information[:, :2, :2], hermitian=True) @ cross[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(information[:, 2, 2] - (cross * gain).sum(axis=1), 0.0))
