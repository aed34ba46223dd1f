"""Checks that the tables of a session fit together, before anything is computed from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MapError
from ...geometry.segments import Floats
from ...graph.factors import MATCH_KINDS, Factor, FactorKind, GraphState
from ...mapping.drift_covariance import odometry_tree
from ...mapping.landmark_table import NEVER_REMOVED, UNOBSERVED
from ...mapping.landmarks import Landmarks
from .tables import ROUNDING

TO_KEYFRAME = (FactorKind.ODOMETRY, FactorKind.LOOP, *MATCH_KINDS, FactorKind.POSE_PRIOR, FactorKind.PINNED_POSE)
FROM_WALL = (FactorKind.WALL_EQUALITY, FactorKind.PLAN_WALL, FactorKind.PINNED_WALL)
"""Kinds of factors whose `first` is a wall."""
TO_WALL = (FactorKind.GAUGE_PRIOR, FactorKind.WALL_HEADING, FactorKind.WALL_OFFSET, *FROM_WALL)
"""Kinds of factors whose `second` is a variable of that kind."""


def check_variables(file: Path, graph: GraphState, landmarks: Landmarks, keyframes: int) -> None:
    """Raise MapError naming `file`, the table of variables, if they are not those of the keyframes and landmarks."""
    if len(graph.keyframes) != keyframes:
        raise MapError(f"{file}: has {len(graph.keyframes)} keyframes, and the table of scans {keyframes}")
    if not _within(graph.point_maps, 0, keyframes):
        raise MapError(f"{file}: has a point map of a keyframe that does not exist")
    for name, ids, table in (("wall", graph.walls, landmarks.walls), ("corner", graph.corners, landmarks.corners)):
        if not _within(ids, 0, len(table)):
            raise MapError(f"{file}: has a {name} that does not exist")
        missing = np.setdiff1d(np.flatnonzero(table.rows["in_graph"]), ids)
        if len(missing):
            raise MapError(f"{file}: the {name} {missing[0]} is confirmed, but is no variable of the graph")


def check_landmarks(file: Path, landmarks: Landmarks, keyframes: int) -> None:
    """Raise MapError naming `file`, the table of walls, if a landmark refers to what does not exist."""
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    seen = [(walls, "first_seen"), (walls, "last_seen"), (corners, "last_seen")]
    valid = _within(walls["removed_at"], NEVER_REMOVED, keyframes)
    for rows, name in seen:  # -1 if no keyframe observes the landmark any more
        valid &= _within(rows[name], -1, keyframes) and _within(rows[name][rows["in_graph"]], 0, keyframes)
    if not valid:
        raise MapError(f"{file}: a landmark was seen in a keyframe that does not exist")
    if not (_within(walls["merged_into"], UNOBSERVED, len(walls)) and _within(corners["walls"], -1, len(walls))):
        raise MapError(f"{file}: a landmark refers to a wall that does not exist")


def check_factors(
    file: Path, graph: GraphState, factors: Sequence[Factor], unconfirmed: Sequence[Factor], landmarks: Landmarks
) -> None:
    """Raise MapError naming `file`, the table of factors, if a factor is between variables that do not exist, a
    variable has no factor, a landmark waits for the solution of a graph that is solved, or odometry leads from a
    keyframe to one before it.
    """
    keyframes = set(range(len(graph.keyframes)))
    walls, corners, point_maps = (set(ids.tolist()) for ids in (graph.walls, graph.corners, graph.point_maps))
    names = {"keyframe": keyframes, "wall": walls, "corner": corners, "point map": point_maps}
    for factor in factors:
        first, second = _variables(factor.kind)
        if factor.first not in names[first] or factor.second not in names[second]:
            raise _not_found(file, factor)
        if factor.kind is FactorKind.ODOMETRY and factor.first >= factor.second:
            raise MapError(f"{file}: odometry leads from the keyframe {factor.first} back to {factor.second}")
    used, solved = _used(factors), _used(factors[: len(factors) - graph.waiting])
    for name, variables in names.items():
        if unused := variables - used[name]:
            raise MapError(f"{file}: no factor has the {name} {min(unused)}")
    for name in ("wall", "corner"):
        waiting = names[name] - solved[name]
        if waiting and len(keyframes) - 1 in solved["keyframe"]:
            raise MapError(f"{file}: the {name} {min(waiting)} waits for a solution, but no keyframe does")
    for factor in unconfirmed:
        known = len(landmarks.corners if factor.kind is FactorKind.CORNER else landmarks.walls)
        if factor.first not in keyframes or not 0 <= factor.second < known:
            raise _not_found(file, factor)


def check_drift(file: Path, drift: Floats, factors: Sequence[Factor]) -> None:
    """Raise MapError naming `file`, the table of keyframes, if the correlated drift (k, 2, 2) shrinks on the way."""
    growth = drift.copy()
    growth[1:] -= drift[odometry_tree(factors, len(drift))[1:]]
    rounding = ROUNDING * np.trace(drift, axis1=1, axis2=2)
    if (np.linalg.eigvalsh(growth)[:, 0] < -rounding).any():
        raise MapError(f"{file}: the correlated drift of a keyframe is less than that of the one before")


def _variables(kind: FactorKind) -> tuple[str, str]:
    """Return what the `first` and the `second` variable of a kind of factors are."""
    if kind is FactorKind.SCAN_MATCH:
        return "point map", "keyframe"
    if kind is FactorKind.POINT_MAP:
        return "keyframe", "point map"
    second = "keyframe" if kind in TO_KEYFRAME else "wall" if kind in TO_WALL else "corner"
    return "wall" if kind in FROM_WALL else "keyframe", second


def _used(factors: Sequence[Factor]) -> dict[str, set[int]]:
    """Return the variables that some factors have."""
    used: dict[str, set[int]] = {name: set() for name in ("keyframe", "wall", "corner", "point map")}
    for factor in factors:
        for name, variable in zip(_variables(factor.kind), (factor.first, factor.second), strict=True):
            used[name].add(variable)
    return used


def _not_found(file: Path, factor: Factor) -> MapError:
    between = f"from {factor.first} to {factor.second}"
    return MapError(f"{file}: a factor of kind {factor.kind} {between} has a variable that does not exist")


def _within(values: NDArray[np.int64], low: int, end: int) -> bool:
    """Return True if all values are in [low, end)."""
    return bool(((values >= low) & (values < end)).all())
