"""Read the results of a run back from its output directory."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..config import Config, load_config
from ..errors import MapError, first_line
from ..geometry.segments import Floats
from ..mapping.map_features import MapCorners, MapWalls
from .keyframes_csv import Keyframes, read_keyframes
from .map_json import read_map
from .output_dir import CONFIG, KEYFRAMES, MAP, SUMMARY, TRAJECTORY
from .recorded_stamps import as_read
from .tum import Trajectory, read_tum_poses

TABLES = ("recordings", "devices")
SUMMARY_TYPES: dict[str, type[dict[str, Any]] | type[list[Any]]] = {
    **dict.fromkeys(("slam", "skipped", "truth", "versions", "timing", "review"), dict),
    **dict.fromkeys(("warnings", "interpretations", "doubts", *TABLES), list),
}
"""Types of the entries of summary.json that are not plain values."""


@dataclass(frozen=True, slots=True, eq=False)
class RunResults:
    """Results of a run in the directory `path`; `keyframes` is None if the directory has no keyframes.csv."""

    path: Path
    walls: MapWalls
    corners: MapCorners
    trajectory: Trajectory
    summary: dict[str, Any]
    keyframes: Keyframes | None

    def config(self) -> Config:
        """Read the settings of the run. Raises ConfigurationError if that is not possible."""
        return load_config(self.path / CONFIG)

    def mounts(self) -> Floats:
        """Return the mounts (k, 3) of the lidars; one at the origin of the base if they are unknown.

        Raises MapError if the summary is damaged.
        """
        try:
            mounts = np.array(self.summary.get("lidars") or [[0.0, 0.0, 0.0]], dtype=np.float64)
        except (TypeError, ValueError):
            mounts = np.zeros(0)
        if mounts.ndim != 2 or mounts.shape[1] != 3 or not np.isfinite(mounts).all():
            raise MapError(f"{self.path / SUMMARY}: lidars must have x, y and heading of each")
        return mounts


def read_run_results(path: Path) -> RunResults:
    """Read the results in the output directory of a run. Raises MapError naming the file that is missing or invalid."""
    if not path.is_dir():
        raise MapError(f"{path}: is not a directory; expected the output directory of `wclm run`")
    for name in (MAP, TRAJECTORY, SUMMARY):
        if not (path / name).is_file():
            raise MapError(f"{path}: has no {name}; expected the output directory of `wclm run`")
    map_file = read_map(path / MAP)
    summary = _read_summary(path / SUMMARY)
    stamps, poses = read_tum_poses(path / TRAJECTORY)
    try:
        stamps = as_read(stamps, summary)
    except (AttributeError, ArithmeticError, TypeError, ValueError) as error:
        raise MapError(f"{path / SUMMARY}: recordings is invalid: {first_line(error)}") from error
    return RunResults(
        path,
        map_file.walls,
        map_file.corners,
        Trajectory.sorted(stamps, poses),
        summary,
        read_keyframes(path / KEYFRAMES) if (path / KEYFRAMES).is_file() else None,
    )


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise MapError(f"{path}: is not JSON: {first_line(error)}") from error
    if not isinstance(summary, dict):
        raise MapError(f"{path}: is not the summary of a run")
    for name, kind in SUMMARY_TYPES.items():
        if not isinstance(summary.get(name) or kind(), kind):
            raise MapError(f"{path}: {name} is not a {'table' if kind is dict else 'list'}")
    if not all(isinstance(row, dict) for name in TABLES for row in summary.get(name) or ()):
        raise MapError(f"{path}: {' or '.join(TABLES)} has an entry that is not a table")
    return summary
