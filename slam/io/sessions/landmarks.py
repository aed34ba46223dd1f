"""Write and read the tables of walls and corners, with a row for each landmark in the order of their ids.

They include landmarks that are not confirmed, merged or removed. Walls that no keyframe observes any more have infinite
ends, such corners a position of NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...bounds import MAX_DEVIATION, MAX_MAGNITUDE
from ...errors import MapError
from ...geometry.segments import Floats
from ...mapping.landmark_table import CORNER_DTYPE, WALL_DTYPE
from ...mapping.landmarks import Landmarks
from ...mapping.wall_removal import FreeSpaceEvidence
from .tables import POSE_COLUMNS, Ragged, TableReader, are_semidefinite, to_ragged, write_table

WALL_INTEGERS = ("observations", "first_seen", "last_seen", "merged_into", "removed_at")
CORNER_INTEGERS = ("observations", "last_seen")
UPPER_TRIANGLE_2X2 = (0, 0, 1), (0, 1, 1)

COVARIANCES = ("covariance", "covariance_in_map")
MAP_PREFIX = "map_"
"""Prefix of the columns of `covariance_in_map`."""
WALL_COVARIANCE = ("offset_offset", "offset_heading", "heading_heading")
CORNER_COVARIANCE = ("xx", "xy", "yy")

MAX_EXTENT = 1e5
"""Metres from a wall's frame to its ends; the walls of buildings end some hundred metres from it."""

COVERED_CELLS = "covered_cells"
OPENED_CELLS = ("opened_cells", "opened_at")
FREE_SPACE_EVIDENCE = ("free_space_cells", "free_space_counts")
"""Cells of a wall, and a number for each of them."""


def write_walls(file: Path, landmarks: Landmarks, free_space_evidence: FreeSpaceEvidence) -> None:
    """Write the table of walls. Raises OSError."""
    rows = landmarks.walls.rows
    covered = [np.sort(np.array(list(cells), dtype=np.int64)) for cells in landmarks.covered]
    covariance, in_map = (rows[name][:, UPPER_TRIANGLE_2X2[0], UPPER_TRIANGLE_2X2[1]] for name in COVARIANCES)
    write_table(
        file,
        {
            **{name: rows["frame"][:, k] for k, name in enumerate(POSE_COLUMNS)},
            **{name: rows[name] for name in ("low", "high")},
            **{name: rows[name].astype(np.int32) for name in WALL_INTEGERS},
            **{name: covariance[:, k] for k, name in enumerate(WALL_COVARIANCE)},
            **{f"{MAP_PREFIX}{name}": in_map[:, k] for k, name in enumerate(WALL_COVARIANCE)},
            "in_graph": rows["in_graph"],
            COVERED_CELLS: to_ragged(covered, np.int32),
            **_cell_columns(OPENED_CELLS, landmarks.opened, len(rows)),
            **_cell_columns(FREE_SPACE_EVIDENCE, free_space_evidence.counts, len(rows)),
        },
    )


def write_corners(file: Path, landmarks: Landmarks) -> None:
    """Write the table of corners. Raises OSError."""
    rows = landmarks.corners.rows
    covariance, in_map = (rows[name][:, UPPER_TRIANGLE_2X2[0], UPPER_TRIANGLE_2X2[1]] for name in COVARIANCES)
    write_table(
        file,
        {
            **{name: rows["position"][:, k] for k, name in enumerate(("x", "y"))},
            **{name: rows["headings"][:, k] for k, name in enumerate(("heading_before", "heading_after"))},
            **{name: rows["walls"][:, k].astype(np.int32) for k, name in enumerate(("wall_before", "wall_after"))},
            **{name: rows[name].astype(np.int32) for name in CORNER_INTEGERS},
            **{name: covariance[:, k] for k, name in enumerate(CORNER_COVARIANCE)},
            **{f"{MAP_PREFIX}{name}": in_map[:, k] for k, name in enumerate(CORNER_COVARIANCE)},
            "in_graph": rows["in_graph"],
        },
    )


def _cell_columns(names: tuple[str, str], by_wall: Mapping[int, Mapping[int, int]], walls: int) -> dict[str, Ragged]:
    """Return two ragged columns: the cells of each of n walls, and their numbers."""
    cells = [sorted(by_wall.get(wall, {}).items()) for wall in range(walls)]
    return {
        name: to_ragged([np.array(items).reshape(-1, 2)[:, k] for items in cells], np.int32)
        for k, name in enumerate(names)
    }


def _read_cells(table: TableReader, names: tuple[str, str]) -> dict[int, dict[int, int]]:
    """Return the numbers by wall and cell."""
    values, lengths = table.ragged_integers(*names)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    return {wall: dict(values[ends[wall] : ends[wall + 1]].tolist()) for wall in np.flatnonzero(lengths).tolist()}


def read_free_space_evidence(walls: Path) -> FreeSpaceEvidence:
    """Read the free-space evidence from the table of walls. Raises MapError naming the file."""
    return FreeSpaceEvidence(_read_cells(TableReader(walls), FREE_SPACE_EVIDENCE))


def read_landmarks(walls: Path, corners: Path) -> Landmarks:
    """Read both tables. Raises MapError naming the file."""
    table = TableReader(walls)
    cells, lengths = table.ragged_integers(COVERED_CELLS)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    flat = cells[:, 0].tolist()
    covered = [frozenset(flat[ends[k] : ends[k + 1]]) for k in range(len(table))]
    return Landmarks.from_tables(
        _read_walls(table, walls), _read_corners(corners), covered, _read_cells(table, OPENED_CELLS)
    )


def _read_walls(table: TableReader, file: Path) -> NDArray[np.void]:
    rows = np.zeros(len(table), WALL_DTYPE)
    rows["frame"] = table.floats(*POSE_COLUMNS)
    rows["low"], rows["high"] = (table.floats(name, finite=False, limit=MAX_MAGNITUDE) for name in ("low", "high"))
    for name in WALL_INTEGERS:
        rows[name] = table.integers(name)
    for name, prefix in zip(COVARIANCES, ("", MAP_PREFIX), strict=True):
        rows[name] = _read_covariances(table, file, [f"{prefix}{entry}" for entry in WALL_COVARIANCE])
    rows["in_graph"] = table.booleans("in_graph")
    observed = (rows["low"] != np.inf) | (rows["high"] != -np.inf)
    if not (np.maximum(np.abs(rows["low"]), np.abs(rows["high"]))[observed] < MAX_EXTENT).all():
        raise MapError(f"{file}: a wall has an end that is not within {MAX_EXTENT:g} m")
    if (rows["merged_into"] >= len(rows)).any():
        raise MapError(f"{file}: a wall is merged into a wall that does not exist")
    return rows


def _read_corners(file: Path) -> NDArray[np.void]:
    table = TableReader(file)
    rows = np.zeros(len(table), CORNER_DTYPE)
    rows["position"] = table.floats("x", "y", finite=False)
    rows["headings"] = table.floats("heading_before", "heading_after")
    rows["walls"] = table.integers("wall_before", "wall_after")
    for name in CORNER_INTEGERS:
        rows[name] = table.integers(name)
    for name, prefix in zip(COVARIANCES, ("", MAP_PREFIX), strict=True):
        rows[name] = _read_covariances(table, file, [f"{prefix}{entry}" for entry in CORNER_COVARIANCE])
    rows["in_graph"] = table.booleans("in_graph")
    return rows


def _read_covariances(table: TableReader, file: Path, names: Sequence[str]) -> Floats:
    """Return the symmetric matrices (n, 2, 2) of the columns of their upper triangles. Raises MapError."""
    covariances = table.floats(*names, limit=MAX_DEVIATION**2)[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    if not are_semidefinite(covariances):
        raise MapError(f"{file}: the covariance of a landmark has a negative variance")
    return np.asarray(covariances)
