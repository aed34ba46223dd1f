"""Keys and names of the variables of a graph that is stored as plain data."""

from __future__ import annotations

import gtsam
from gtsam.symbol_shorthand import C, L, P, X

from .factors import GraphState

NAMES = {"x": "keyframe", "l": "wall", "c": "corner", "p": "point map"}
"""Names of the kinds of variables by the characters of their keys."""


def keyframe_keys(state: GraphState) -> list[int]:
    """Return the keys of the keyframes, in their order."""
    return [X(k) for k in range(len(state.keyframes))]


def landmark_keys(state: GraphState) -> set[int]:
    """Return the keys of the walls and corners."""
    return {L(j) for j in state.walls.tolist()} | {C(j) for j in state.corners.tolist()}


def point_map_keys(state: GraphState) -> set[int]:
    """Return the keys of the point maps."""
    return {P(k) for k in state.point_maps.tolist()}


def name_of(key: int) -> str:
    """Return the name of a variable: its kind and its number."""
    symbol = gtsam.Symbol(key)
    return f"{NAMES[chr(symbol.chr())]} {symbol.index()}"
