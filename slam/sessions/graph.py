"""The factor graph: a row for each statement, and one for each variable.

Observations of landmarks that have been seen too seldom to be in the graph are statements, too, which wait.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import MapError
from ..graph import Factor, GraphState, Kind
from ..segments import Floats
from .tables import Columns, ragged, write_table

MEASURED = {Kind.CORNER: 2}
"""How many numbers a factor measures, if not the three of a pose."""
DIMENSION = {Kind.ALONG: 1, Kind.SEGMENT: 2, Kind.CORNER: 2, Kind.SAME: 2}
"""Rows of a factor's covariance, if not the three of a pose. A WALL has a row of three instead."""
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
            "noise": ragged([_numbers(factor) for factor in every], np.float64),
        },
    )


def _numbers(factor: Factor) -> Floats:
    """The upper triangle of a covariance; the row of a WALL."""
    if factor.kind is Kind.WALL:
        return np.asarray(factor.noise[0])
    return np.asarray(factor.noise[np.triu_indices(len(factor.noise))])


def _noise(kind: Kind, numbers: Floats) -> Floats:
    """What these are the numbers of. Raises ValueError where they are too many or too few."""
    if kind is Kind.WALL:
        return numbers.reshape(1, 3)
    size = DIMENSION.get(kind, 3)
    covariance = np.zeros((size, size))
    covariance[np.triu_indices(size)] = numbers
    return covariance + np.triu(covariance, 1).T


def read_factors(file: Path) -> tuple[list[Factor], list[Factor]]:
    """Read the table: the factors, and those that wait. Raises MapError naming the file."""
    table = Columns(file)
    kinds, waits = table.words("kind"), table.flags("waits")
    ends = table.integers("first", "second").tolist()
    measured, sizes = table.ragged_floats("measured")
    noises, noise_sizes = table.ragged_floats("noise")
    measured_at, noise_at = (np.concatenate([[0], np.cumsum(s)]).tolist() for s in (sizes, noise_sizes))
    every = []
    for row, (word, (first, second)) in enumerate(zip(kinds, ends, strict=True)):
        numbers = measured[measured_at[row] : measured_at[row + 1], 0]
        try:
            kind = Kind(word)
            noise = _noise(kind, noises[noise_at[row] : noise_at[row + 1], 0])
        except ValueError as error:
            raise MapError(f"{file}: row {row}: there is no such factor: {str(error).splitlines()[0]}") from error
        if len(numbers) != MEASURED.get(kind, 3):
            raise MapError(f"{file}: row {row}: a factor of kind {kind} does not measure {len(numbers)} numbers")
        every.append(Factor(kind, first, second, numbers, noise))
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
