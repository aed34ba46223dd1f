"""The factor graph: a row for each statement, and one for each variable.

Observations of landmarks that have been seen too seldom to be in the graph are statements, too, which wait.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import MapError
from ...geometry.segments import Floats
from ...graph.factors import Factor, FactorKind, GraphState
from .tables import Columns, ragged, write_table

MEASURED = {FactorKind.CORNER: 2, FactorKind.OFFSET: 4}
"""How many numbers a factor measures, if not the three of a pose."""
DIMENSION = {
    FactorKind.GAUGE_PRIOR: 1,
    FactorKind.HEADING: 1,
    FactorKind.OFFSET: 1,
    FactorKind.WALL: 2,
    FactorKind.CORNER: 2,
    FactorKind.WALL_EQUALITY: 2,
}
"""Rows of a factor's covariance, if not the three of a pose."""
UPPER = {size: np.triu_indices(size) for size in (1, 2, 3)}
KEYFRAME, WALL, CORNER = "keyframe", "wall", "corner"


def write_factors(file: Path, factors: Sequence[Factor], waiting: Sequence[Factor]) -> None:
    """Write the table of factors; those that wait come last. Raises OSError."""
    every = [*factors, *waiting]
    write_table(
        file,
        {
            "kind": [str(factor.kind) for factor in every],
            "waits": np.arange(len(every)) >= len(factors),
            "first": np.array([factor.first for factor in every], dtype=np.int32),
            "second": np.array([factor.second for factor in every], dtype=np.int32),
            "measured": ragged([factor.measured for factor in every], np.float64),
            "covariance": ragged([_upper(factor.covariance) for factor in every], np.float64),
        },
    )


def _upper(matrix: Floats) -> Floats:
    return np.asarray(matrix[UPPER[len(matrix)]])


def read_factors(file: Path) -> tuple[list[Factor], list[Factor]]:
    """Read the table: the factors, and those that wait. Raises MapError naming the file."""
    table = Columns(file)
    kinds, waits = table.words("kind"), table.flags("waits")
    ends = table.integers("first", "second").tolist()
    measured, sizes = table.ragged_floats("measured")
    covariances, covariance_sizes = table.ragged_floats("covariance")
    measured_at, covariance_at = (np.concatenate([[0], np.cumsum(s)]).tolist() for s in (sizes, covariance_sizes))
    every = []
    for row, (word, (first, second)) in enumerate(zip(kinds, ends, strict=True)):
        try:
            kind = FactorKind(word)
        except ValueError as error:
            raise MapError(f"{file}: {word} is no kind of factor") from error
        numbers = measured[measured_at[row] : measured_at[row + 1], 0]
        upper = covariances[covariance_at[row] : covariance_at[row + 1], 0]
        size = DIMENSION.get(kind, 3)
        if len(numbers) != MEASURED.get(kind, 3) or len(upper) != size * (size + 1) // 2:
            raise MapError(f"{file}: a factor of kind {kind} has as many numbers as it cannot have")
        covariance = np.zeros((size, size))
        covariance[np.triu_indices(size)] = upper
        covariance.T[np.triu_indices(size)] = upper
        every.append(Factor(kind, first, second, numbers, covariance))
    split = len(every) - int(waits.sum())
    if not waits[split:].all():
        raise MapError(f"{file}: factors that wait do not come last")
    return every[:split], every[split:]


def write_variables(file: Path, state: GraphState) -> None:
    """Write the table of variables, where they were linearised last. Raises OSError."""
    counts = len(state.keyframes), len(state.walls), len(state.corners)
    corners = np.column_stack([state.positions, np.zeros(len(state.positions))])
    values = np.concatenate([state.keyframes, state.frames, corners])
    identities = np.concatenate([np.arange(counts[0]), state.walls, state.corners])
    kinds = np.repeat([KEYFRAME, WALL, CORNER], counts).tolist()
    columns = {name: values[:, k] for k, name in enumerate(("x", "y", "heading"))}
    write_table(file, {"kind": kinds, "identity": identities.astype(np.int32), **columns})


def read_graph(variables: Path, factors: Sequence[Factor], *, updates: int, qr: bool) -> GraphState:
    """The graph of these variables and factors. Raises MapError naming the file."""
    table = Columns(variables)
    kinds, identities = np.array(table.words("kind"), dtype=str), table.integers("identity")
    values = table.floats("x", "y", "heading")
    keyframes, walls, corners = (kinds == kind for kind in (KEYFRAME, WALL, CORNER))
    if not np.array_equal(identities[keyframes], np.arange(keyframes.sum())):
        raise MapError(f"{variables}: the keyframes are not in order")
    return GraphState(
        factors=list(factors),
        keyframes=values[keyframes],
        walls=identities[walls],
        frames=values[walls],
        corners=identities[corners],
        positions=values[corners, :2],
        updates=updates,
        qr=qr,
    )
