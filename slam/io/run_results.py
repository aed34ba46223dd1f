"""Read the results of a run back from its output directory."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config import Config, load_config
from ..errors import MapError
from ..mapping.map_features import MapCorners, MapWalls
from .keyframes_csv import Keyframes, read_keyframes
from .map_json import read_map
from .output_dir import CONFIG, KEYFRAMES, MAP, SUMMARY, TRAJECTORY
from .recorded_stamps import as_read
from .tum import Trajectory, read_tum_poses


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
    return RunResults(
        path,
        map_file.walls,
        map_file.corners,
        Trajectory.sorted(as_read(stamps, summary), poses),
        summary,
        read_keyframes(path / KEYFRAMES) if (path / KEYFRAMES).is_file() else None,
    )


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise MapError(f"{path}: is not JSON: {error}") from error
    if not isinstance(summary, dict):
        raise MapError(f"{path}: is not the summary of a run")
    return summary
