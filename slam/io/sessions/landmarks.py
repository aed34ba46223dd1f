"""Walls and corners, a row for each: also those that nobody has seen twice, that turned out to be another, or that are
no longer there.

Of what no keyframe sees any more, walls have no extent (it is infinite) and corners no position (it is NaN).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import MapError
from ...geometry.segments import Floats
from ...mapping.landmarks import CORNER, NEVER_REMOVED, WALL, Landmarks
from ...mapping.wall_removal import FreeSpaceEvidence
from .tables import Columns, Ragged, ragged, write_table

COUNTS = ("observations", "first_seen", "last_seen", "merged_into")
CORNER_COUNTS = ("observations", "last_seen")
UPPER = (0, 0, 1), (0, 1, 1)

COVARIANCES = ("covariance", "covariance_in_map")
WALL_COVARIANCE = ("offset_offset", "offset_heading", "heading_heading")
CORNER_COVARIANCE = ("xx", "xy", "yy")
IN_MAP = "map_"
"""Before the names of what is not relative to the last keyframe that saw the landmark."""


OPENED = ("opened", "opened_at")
DOUBTED = ("doubted", "doubts")
"""Cells of a wall, and the number that goes with each. Not in tables of version 1, nor is `retired_at`."""


def write_walls(file: Path, landmarks: Landmarks, free_space_evidence: FreeSpaceEvidence) -> None:
    """Write the table of walls. Raises OSError."""
    rows = landmarks.walls.rows
    covered = [np.sort(np.array(list(cells), dtype=np.int64)) for cells in landmarks.covered]
    covariance, in_map = (rows[name][:, UPPER[0], UPPER[1]] for name in COVARIANCES)
    write_table(
        file,
        {
            **{name: rows["frame"][:, k] for k, name in enumerate(("x", "y", "heading"))},
            **{name: rows[name] for name in ("low", "high")},
            **{name: rows[name].astype(np.int32) for name in (*COUNTS, "removed_at")},
            **{name: covariance[:, k] for k, name in enumerate(WALL_COVARIANCE)},
            **{f"{IN_MAP}{name}": in_map[:, k] for k, name in enumerate(WALL_COVARIANCE)},
            "in_graph": rows["in_graph"],
            "covered": ragged(covered, np.int32),
            **_by_cell(OPENED, landmarks.opened, len(rows)),
            **_by_cell(DOUBTED, free_space_evidence.counts, len(rows)),
        },
    )


def write_corners(file: Path, landmarks: Landmarks) -> None:
    """Write the table of corners. Raises OSError."""
    rows = landmarks.corners.rows
    covariance, in_map = (rows[name][:, UPPER[0], UPPER[1]] for name in COVARIANCES)
    write_table(
        file,
        {
            **{name: rows["position"][:, k] for k, name in enumerate(("x", "y"))},
            **{name: rows["headings"][:, k] for k, name in enumerate(("heading_before", "heading_after"))},
            **{name: rows["walls"][:, k].astype(np.int32) for k, name in enumerate(("wall_before", "wall_after"))},
            **{name: rows[name].astype(np.int32) for name in CORNER_COUNTS},
            **{name: covariance[:, k] for k, name in enumerate(CORNER_COVARIANCE)},
            **{f"{IN_MAP}{name}": in_map[:, k] for k, name in enumerate(CORNER_COVARIANCE)},
            "in_graph": rows["in_graph"],
        },
    )


def _by_cell(names: tuple[str, str], table: Mapping[int, Mapping[int, int]], walls: int) -> dict[str, Ragged]:
    """Two columns of what some cells of some walls have."""
    cells = [sorted(table.get(wall, {}).items()) for wall in range(walls)]
    return {
        name: ragged([np.array(some).reshape(-1, 2)[:, k] for some in cells], np.int32) for k, name in enumerate(names)
    }


def _read_by_cell(table: Columns, names: tuple[str, str]) -> dict[int, dict[int, int]]:
    values, lengths = table.ragged_integers(*names)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    return {wall: dict(values[ends[wall] : ends[wall + 1]].tolist()) for wall in np.flatnonzero(lengths).tolist()}


def read_doubts(walls: Path, version: int) -> FreeSpaceEvidence:
    """Read what was counted of walls that may no longer be there. Raises MapError naming the file."""
    free_space_evidence = FreeSpaceEvidence()
    if version > 1:
        free_space_evidence.counts = _read_by_cell(Columns(walls), DOUBTED)
    return free_space_evidence


def read_landmarks(walls: Path, corners: Path, version: int) -> Landmarks:
    """Read both tables of a session of a version. Raises MapError naming the file."""
    landmarks = Landmarks()
    table = Columns(walls)
    rows = np.zeros(len(table), WALL)
    rows["frame"] = table.floats("x", "y", "heading")
    rows["low"], rows["high"] = table.floats("low", finite=False), table.floats("high", finite=False)
    for name in COUNTS:
        rows[name] = table.integers(name)
    rows["removed_at"] = table.integers("removed_at") if version > 1 else NEVER_REMOVED
    for name, prefix in zip(COVARIANCES, ("", IN_MAP), strict=True):
        rows[name] = _both_halves(table.floats(*(f"{prefix}{entry}" for entry in WALL_COVARIANCE)))
    rows["in_graph"] = table.flags("in_graph")
    if (rows["merged_into"] >= len(rows)).any():
        raise MapError(f"{walls}: a wall is said to be one that is not there")
    landmarks.walls.fill(rows)
    cells, lengths = table.ragged_integers("covered")
    ends = np.concatenate([[0], np.cumsum(lengths)])
    flat = cells[:, 0].tolist()
    landmarks.covered = [frozenset(flat[ends[k] : ends[k + 1]]) for k in range(len(rows))]
    landmarks.opened = _read_by_cell(table, OPENED) if version > 1 else {}

    table = Columns(corners)
    rows = np.zeros(len(table), CORNER)
    rows["position"] = table.floats("x", "y", finite=False)
    rows["headings"] = table.floats("heading_before", "heading_after")
    rows["walls"] = table.integers("wall_before", "wall_after")
    for name in CORNER_COUNTS:
        rows[name] = table.integers(name)
    for name, prefix in zip(COVARIANCES, ("", IN_MAP), strict=True):
        rows[name] = _both_halves(table.floats(*(f"{prefix}{entry}" for entry in CORNER_COVARIANCE)))
    rows["in_graph"] = table.flags("in_graph")
    landmarks.corners.fill(rows)
    return landmarks


def _both_halves(upper: Floats) -> Floats:
    """(n, 2, 2) from the upper halves (n, 3)."""
    return upper[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
