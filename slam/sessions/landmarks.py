"""Walls and corners, a row for each: also those that nobody has seen twice, or that turned out to be another.

Of what no keyframe sees any more, walls have no extent (it is infinite) and corners no position (it is NaN).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import MapError
from ..landmarks import CORNER, WALL, Landmarks
from .tables import Columns, ragged, write_table

COUNTS = ("observations", "first_seen", "last_seen", "kept")
CORNER_COUNTS = ("observations", "last_seen")
UPPER = (0, 0, 1), (0, 1, 1)


def write_walls(file: Path, landmarks: Landmarks) -> None:
    """Write the table of walls. Raises OSError."""
    rows = landmarks.walls.rows
    covered = [np.sort(np.array(list(cells), dtype=np.int64)) for cells in landmarks.covered]
    covariance = rows["covariance"][:, UPPER[0], UPPER[1]]
    write_table(
        file,
        {
            **{name: rows["frame"][:, k] for k, name in enumerate(("x", "y", "heading"))},
            **{name: rows[name] for name in ("low", "high")},
            **{name: rows[name].astype(np.int32) for name in COUNTS},
            **{name: covariance[:, k] for k, name in enumerate(("offset_offset", "offset_heading", "heading_heading"))},
            "in_graph": rows["in_graph"],
            "covered": ragged(covered, np.int32),
        },
    )


def write_corners(file: Path, landmarks: Landmarks) -> None:
    """Write the table of corners. Raises OSError."""
    rows = landmarks.corners.rows
    covariance = rows["covariance"][:, UPPER[0], UPPER[1]]
    write_table(
        file,
        {
            **{name: rows["position"][:, k] for k, name in enumerate(("x", "y"))},
            **{name: rows["headings"][:, k] for k, name in enumerate(("heading_before", "heading_after"))},
            **{name: rows["walls"][:, k].astype(np.int32) for k, name in enumerate(("wall_before", "wall_after"))},
            **{name: rows[name].astype(np.int32) for name in CORNER_COUNTS},
            **{name: covariance[:, k] for k, name in enumerate(("xx", "xy", "yy"))},
            "in_graph": rows["in_graph"],
        },
    )


def read_landmarks(walls: Path, corners: Path) -> Landmarks:
    """Read both tables. Raises MapError naming the file."""
    landmarks = Landmarks()
    table = Columns(walls)
    rows = np.zeros(len(table), WALL)
    rows["frame"] = table.floats("x", "y", "heading")
    rows["low"], rows["high"] = table.floats("low", finite=False), table.floats("high", finite=False)
    for name in COUNTS:
        rows[name] = table.integers(name)
    rows["covariance"] = table.floats("offset_offset", "offset_heading", "heading_heading")[:, [0, 1, 1, 2]].reshape(
        -1, 2, 2
    )
    rows["in_graph"] = table.flags("in_graph")
    if (rows["kept"] >= len(rows)).any():
        raise MapError(f"{walls}: a wall is said to be one that is not there")
    landmarks.walls.fill(rows)
    cells, lengths = table.ragged_integers("covered")
    ends = np.concatenate([[0], np.cumsum(lengths)])
    flat = cells[:, 0].tolist()
    landmarks.covered = [frozenset(flat[ends[k] : ends[k + 1]]) for k in range(len(rows))]

    table = Columns(corners)
    rows = np.zeros(len(table), CORNER)
    rows["position"] = table.floats("x", "y", finite=False)
    rows["headings"] = table.floats("heading_before", "heading_after")
    rows["walls"] = table.integers("wall_before", "wall_after")
    for name in CORNER_COUNTS:
        rows[name] = table.integers(name)
    rows["covariance"] = table.floats("xx", "xy", "yy")[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    rows["in_graph"] = table.flags("in_graph")
    landmarks.corners.fill(rows)
    return landmarks
