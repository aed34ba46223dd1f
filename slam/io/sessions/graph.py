"""Write and read the factor graph: a table with a row for each factor, and one with a row for each variable.

Observations of landmarks that are not confirmed, and therefore not in the graph yet, are rows of the table of factors
too, marked as unconfirmed.
"""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...bounds import MAX_MAGNITUDE
from ...errors import MapError
from ...geometry.segments import Floats
from ...graph.factors import Factor, FactorKind, GraphState
from .tables import POSE_COLUMNS, TableReader, are_covariances, to_ragged, write_table

MEASUREMENT_SIZES = {FactorKind.CORNER: 2, FactorKind.WALL_OFFSET: 4}
"""Length of a factor's measurement, if it is not a pose (3)."""
COVARIANCE_SIZES = {
    FactorKind.GAUGE_PRIOR: 1,
    FactorKind.WALL_HEADING: 1,
    FactorKind.WALL_OFFSET: 1,
    FactorKind.WALL: 2,
    FactorKind.CORNER: 2,
    FactorKind.WALL_EQUALITY: 2,
    FactorKind.PLAN_WALL: 2,
    FactorKind.PINNED_WALL: 2,
}
"""Rows of a factor's covariance, if it is not that of a pose (3)."""
POSE_SIZE = 3
BIAS_SLOPE_SIZES = {FactorKind.WALL_HEADING: 1, FactorKind.WALL_OFFSET: 1, FactorKind.WALL: 2, FactorKind.CORNER: 2}
"""Length of a factor's slope with the range bias, if it has one."""
UPPER_TRIANGLES = {size: np.triu_indices(size) for size in (1, 2, 3)}
KEYFRAME, WALL, CORNER, POINT_MAP = "keyframe", "wall", "corner", "point_map"
"""Values of the column `kind` of the table of variables."""


def write_factors(file: Path, factors: Sequence[Factor], unconfirmed: Sequence[Factor]) -> None:
    """Write the table of factors, then the observations of unconfirmed landmarks. Raises OSError."""
    rows = [*factors, *unconfirmed]
    write_table(
        file,
        {
            "kind": [str(factor.kind) for factor in rows],
            "unconfirmed": np.arange(len(rows)) >= len(factors),
            "first": np.array([factor.first for factor in rows], dtype=np.int32),
            "second": np.array([factor.second for factor in rows], dtype=np.int32),
            "measured": to_ragged([factor.measured for factor in rows], np.float64),
            "bias_slope": to_ragged([factor.bias_slope for factor in rows], np.float64),
            "covariance": to_ragged([_upper_triangle(factor.covariance) for factor in rows], np.float64),
        },
    )


def _upper_triangle(matrix: Floats) -> Floats:
    return matrix[0] if len(matrix) == 1 else np.asarray(matrix[UPPER_TRIANGLES[len(matrix)]])


def read_factors(file: Path) -> tuple[list[Factor], list[Factor]]:
    """Read the factors, and the observations of unconfirmed landmarks. Raises MapError naming the file."""
    table = TableReader(file)
    kinds, unconfirmed = table.strings("kind"), table.booleans("unconfirmed")
    variables = table.integers("first", "second").tolist()
    measured, sizes = table.ragged_floats("measured")
    covariances, covariance_sizes = table.ragged_floats("covariance", limit=MAX_MAGNITUDE)
    slopes, slope_sizes = table.ragged_floats("bias_slope")
    measured_ends, covariance_ends, slope_ends = (
        np.concatenate([[0], np.cumsum(s)]).tolist() for s in (sizes, covariance_sizes, slope_sizes)
    )
    factors = []
    for row, (name, (first, second)) in enumerate(zip(kinds, variables, strict=True)):
        try:
            kind = FactorKind(name)
        except ValueError as error:
            raise MapError(f"{file}: unknown kind of factor: {reprlib.repr(name)}") from error
        numbers = measured[measured_ends[row] : measured_ends[row + 1], 0]
        upper = covariances[covariance_ends[row] : covariance_ends[row + 1], 0]
        slope = slopes[slope_ends[row] : slope_ends[row + 1], 0]
        size = COVARIANCE_SIZES.get(kind, POSE_SIZE)
        if len(numbers) != MEASUREMENT_SIZES.get(kind, POSE_SIZE) or len(upper) != size * (size + 1) // 2:
            raise MapError(f"{file}: a factor of kind {kind} has a measurement or covariance of the wrong size")
        if len(slope) != BIAS_SLOPE_SIZES.get(kind, 0):
            raise MapError(f"{file}: a factor of kind {kind} has a slope of the wrong size")
        covariance = np.zeros((size, size))
        covariance[UPPER_TRIANGLES[size]] = upper
        covariance.T[UPPER_TRIANGLES[size]] = upper
        factors.append(Factor(kind, first, second, numbers, covariance, slope))
    for size in sorted({len(factor.covariance) for factor in factors}):
        if not are_covariances(np.array([f.covariance for f in factors if len(f.covariance) == size])):
            raise MapError(f"{file}: the covariance of a factor is not positive definite")
    count = len(factors) - int(unconfirmed.sum())
    if not unconfirmed[count:].all():
        raise MapError(f"{file}: unconfirmed observations must be the last rows")
    return factors[:count], factors[count:]


def write_variables(file: Path, state: GraphState) -> None:
    """Write the table of variables at their linearisation points. Raises OSError."""
    counts = len(state.keyframes), len(state.walls), len(state.corners), len(state.point_maps)
    corners = np.column_stack([state.positions, np.zeros(len(state.positions))])
    values = np.concatenate([state.keyframes, state.frames, corners, state.point_map_poses])
    ids = np.concatenate([np.arange(counts[0]), state.walls, state.corners, state.point_maps])
    kinds = np.repeat([KEYFRAME, WALL, CORNER, POINT_MAP], counts).tolist()
    columns = {name: values[:, k] for k, name in enumerate(POSE_COLUMNS)}
    write_table(file, {"kind": kinds, "id": ids.astype(np.int32), **columns})


def read_graph(
    variables: Path, factors: Sequence[Factor], *, updates: int, qr: bool, range_bias: float, waiting: int
) -> GraphState:
    """Read the table of variables and combine it with `factors`; see `GraphState` for the rest.

    Raises MapError naming the file.
    """
    if waiting > len(factors):
        raise MapError(f"{variables}: {waiting} of {len(factors)} factors cannot be waiting")
    table = TableReader(variables)
    kinds, ids = np.array(table.strings("kind"), dtype=str), table.integers("id")
    values = table.floats(*POSE_COLUMNS)
    keyframes, walls, corners, point_maps = (kinds == kind for kind in (KEYFRAME, WALL, CORNER, POINT_MAP))
    if not np.array_equal(ids[keyframes], np.arange(keyframes.sum())):
        raise MapError(f"{variables}: the keyframes are not in order")
    return GraphState(
        factors=list(factors),
        keyframes=values[keyframes],
        walls=ids[walls],
        frames=values[walls],
        corners=ids[corners],
        positions=values[corners, :2],
        point_maps=ids[point_maps],
        point_map_poses=values[point_maps],
        updates=updates,
        qr=qr,
        bias=range_bias,
        waiting=waiting,
    )
