"""Write and read the loop decisions of a session: a row for each, with the same values as in `summary.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...bounds import MAX_MAGNITUDE
from .tables import TableReader, write_table

STRINGS = ("status", "reason")
INTEGERS = ("candidate", "keyframe", "old", "matches", "merged")
FLOATS = ("stamp", "overlap_ratio", "runner_up", "sigma", "contradicted", "shift")
MOTION = ("motion_x", "motion_y", "motion_heading")


def write_loop_decisions(file: Path, decisions: Sequence[Mapping[str, Any]]) -> None:
    """Write the table. Raises OSError."""
    columns: dict[str, Any] = {name: [str(row[name]) for row in decisions] for name in STRINGS}
    columns |= {name: np.array([row[name] for row in decisions], dtype=np.int32) for name in INTEGERS}
    columns |= {name: np.array([row[name] for row in decisions], dtype=np.float64) for name in FLOATS}
    motions = np.array([row["motion"] for row in decisions], dtype=np.float64).reshape(-1, 3)
    columns |= {name: motions[:, k] for k, name in enumerate(MOTION)}
    write_table(file, columns)


def read_loop_decisions(file: Path) -> list[dict[str, Any]]:
    """Read the table. Raises MapError naming the file."""
    table = TableReader(file)
    columns: dict[str, list[Any]] = {name: table.integers(name).tolist() for name in INTEGERS}
    columns |= {name: table.floats(name, limit=MAX_MAGNITUDE).tolist() for name in FLOATS}
    columns |= {name: table.strings(name) for name in STRINGS}
    columns["motion"] = table.floats(*MOTION).tolist()
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
