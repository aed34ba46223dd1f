"""Take the walls of an earlier run as a plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...mapping.plan import Plan
from ..run_results import read_run_results
from .drawing import MAP_PRECISION


def read_earlier_map(path: Path) -> Plan:
    """Read the walls in the output directory of a run; they are seen from one side. Raises MapError."""
    results = read_run_results(path)
    segments = results.walls.piece_points()[0]
    positions = results.trajectory.poses[:, :2]
    return Plan(path.name, segments, np.ones(len(segments), dtype=bool), MAP_PRECISION, positions)
