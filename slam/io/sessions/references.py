"""Checks that the tables of a session fit together, before anything is computed from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import MapError
from ...geometry.segments import Floats
from ...graph.factors import Factor, FactorKind, GraphState, keys_of
from ...graph.variable_keys import keyframe_keys, landmark_keys, name_of, point_map_keys
from ...mapping.drift_covariance import odometry_tree
from ...mapping.keyframes import LandmarkIds
from ...mapping.landmark_table import NEVER_REMOVED, UNOBSERVED
from ...mapping.landmarks import Landmarks
from .tables import ROUNDING


def check_variables(file: Path, graph: GraphState, landmarks: Landmarks, keyframes: int) -> None:
    """Raise MapError naming `file`, the table of variables, if they are not those of the keyframes and landmarks."""
    if len(graph.keyframes) != keyframes:
        raise MapError(f"{file}: has {len(graph.keyframes)} keyframes, and the table of scans {keyframes}")
    if not _within(graph.point_maps, 0, keyframes):
        raise MapError(f"{file}: has a point map of a keyframe that does not exist")
    for name, ids, table in (("wall", graph.walls, landmarks.walls), ("corner", graph.corners, landmarks.corners)):
        confirmed = np.flatnonzero(table.rows["in_graph"])
        if len(missing := np.setdiff1d(confirmed, ids)):
            raise MapError(f"{file}: the {name} {missing[0]} is confirmed, but is no variable of the graph")
        if len(unknown := np.setdiff1d(ids, confirmed)):
            raise MapError(f"{file}: the {name} {unknown[0]} is a variable of the graph, but is not confirmed")
    for name, ids in (("wall", graph.walls), ("corner", graph.corners), ("point map", graph.point_maps)):
        if (np.diff(ids) <= 0).any():
            raise MapError(f"{file}: has a {name} twice, or not in the order of their numbers")


def check_landmarks(file: Path, landmarks: Landmarks, keyframes: int) -> None:
    """Raise MapError naming `file`, the table of walls, if a landmark refers to what does not exist."""
    walls, corners = landmarks.walls.rows, landmarks.corners.rows
    seen = [(walls, "first_seen"), (walls, "last_seen"), (corners, "last_seen")]
    valid = _within(walls["removed_at"], NEVER_REMOVED, keyframes)
    for rows, name in seen:  # -1 if no keyframe observes the landmark any more
        observed = (rows["observations"] != 0) | rows["in_graph"]
        valid &= _within(rows[name], -1, keyframes) and _within(rows[name][observed], 0, keyframes)
    if not valid:
        raise MapError(f"{file}: a landmark was seen in a keyframe that does not exist")
    if not (_within(walls["merged_into"], UNOBSERVED, len(walls)) and _within(corners["walls"], -1, len(walls))):
        raise MapError(f"{file}: a landmark refers to a wall that does not exist")


def check_landmark_ids(file: Path, landmark_ids: Sequence[LandmarkIds], landmarks: Landmarks) -> None:
    """Raise MapError naming `file`, the table of scans, if a keyframe observes a landmark that does not exist."""
    for ids in landmark_ids:  # -1 where no landmark is observed
        if not (_within(ids.walls, -1, len(landmarks.walls)) and _within(ids.corners, -1, len(landmarks.corners))):
            raise MapError(f"{file}: a keyframe observes a landmark that does not exist")


def check_factors(
    file: Path, graph: GraphState, factors: Sequence[Factor], unconfirmed: Sequence[Factor], landmarks: Landmarks
) -> None:
    """Raise MapError naming `file`, the table of factors, if a factor is between variables that do not exist, a
    variable has no factor, a landmark waits for the solution of a graph that is solved, or odometry leads from a
    keyframe to one before it.
    """
    keyframes, in_graph = keyframe_keys(graph), landmark_keys(graph)
    existing = in_graph.union(keyframes, point_map_keys(graph))
    for factor in factors:
        if not existing.issuperset(keys_of(factor)):
            raise _not_found(file, factor)
        if factor.kind is FactorKind.ODOMETRY and factor.first >= factor.second:
            raise MapError(f"{file}: odometry leads from the keyframe {factor.first} back to {factor.second}")
    solved, waiting = factors[: len(factors) - graph.waiting], factors[len(factors) - graph.waiting :]
    solved_keys = {key for factor in solved for key in keys_of(factor)}
    unsolved = existing - solved_keys
    if unused := unsolved.difference(*(keys_of(factor) for factor in waiting)):
        raise MapError(f"{file}: no factor has the {name_of(min(unused))}")
    unsolved &= in_graph
    if unsolved and solved_keys.intersection(keyframes[-1:]):
        raise MapError(f"{file}: the {name_of(min(unsolved))} waits for a solution, but no keyframe does")
    for factor in unconfirmed:
        known = len(landmarks.corners if factor.kind is FactorKind.CORNER else landmarks.walls)
        if not 0 <= factor.first < len(keyframes) or not 0 <= factor.second < known:
            raise _not_found(file, factor)


def check_drift(file: Path, drift: Floats, factors: Sequence[Factor]) -> None:
    """Raise MapError naming `file`, the table of keyframes, if the correlated drift (k, 2, 2) shrinks on the way."""
    growth = drift.copy()
    growth[1:] -= drift[odometry_tree(factors, len(drift))[1:]]
    rounding = ROUNDING * np.trace(drift, axis1=1, axis2=2)
    if (np.linalg.eigvalsh(growth)[:, 0] < -rounding).any():
        raise MapError(f"{file}: the correlated drift of a keyframe is less than that of the one before")


def _not_found(file: Path, factor: Factor) -> MapError:
    between = f"from {factor.first} to {factor.second}"
    return MapError(f"{file}: a factor of kind {factor.kind} {between} has a variable that does not exist")


def _within(values: NDArray[np.int64], low: int, end: int) -> bool:
    """Return True if all values are in [low, end)."""
    return bool(((values >= low) & (values < end)).all())
