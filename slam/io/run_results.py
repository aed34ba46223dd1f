"""Write the results of a run into its output directory, and read them back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.immutable import immutable

from ..config import Config, config_to_toml, load_config, validated_config
from ..errors import MapError, first_line
from ..events import Finished
from ..formatting import counted
from ..geometry.segments import Floats
from ..mapping.map_features import Keyframes, MapCorners, MapWalls
from .drives import split_drives
from .json_files import read_json, to_json_types, write_json
from .keyframes_csv import read_keyframes, write_keyframes
from .map_json import read_map, write_map
from .output_dir import CONFIG, KEYFRAMES, MAP, SUMMARY, TRAJECTORY, require_results
from .recorded_stamps import as_read, as_recorded
from .tum import Trajectory, read_tum_poses, write_tum

TABLES = ("recordings", "devices")
SUMMARY_TYPES: dict[str, type[dict[str, Any]] | type[list[Any]]] = {
    **dict.fromkeys(("slam", "skipped", "corrected", "truth", "versions", "timing", "second_timing", "review"), dict),
    **dict.fromkeys(("warnings", "interpretations", "doubts", "gaps", *TABLES), list),
}
"""Types of the entries of summary.json that are not plain values."""


@immutable
class RunResults:
    """Results of a run in the directory `path`; `keyframes` is None if the directory has no keyframes.csv."""

    path: Path
    walls: MapWalls
    corners: MapCorners
    trajectory: Trajectory
    summary: dict[str, Any]
    keyframes: Keyframes | None

    def __repr__(self) -> str:
        sizes = f"{counted(len(self.walls), 'wall')}, {counted(len(self.corners), 'corner')}"
        return f"<RunResults of {self.path}: {sizes}, {self.trajectory.length:.1f} m driven>"

    def drives(self) -> list[Trajectory]:
        """Return the trajectories of the drives: one for each recording, in the order of their stamps."""
        return split_drives(self.trajectory, self.summary.get("recordings") or ())

    def config(self) -> Config:
        """Read the settings of the run. Raises ConfigurationError if that is not possible."""
        return load_config(self.path / CONFIG)

    def recordings(self) -> list[dict[str, Any]]:
        """Return what the summary states of each recording; a summary of older versions is that of the only one."""
        single = {"name": self.summary.get("recording", ""), "path": self.summary.get("recording_path")}
        return self.summary.get("recordings") or [single]

    def settings_as_used(self, recording: Mapping[str, Any]) -> Config:
        """Return the settings with which a recording, an entry of `recordings`, was read and its scans were placed.

        Results of older versions state some of them only. Raises ConfigurationError.
        """
        if "settings" in recording:
            return validated_config(recording["settings"], f"{self.path / SUMMARY}: settings of a recording")
        data, stated = self.config().model_dump(), recording.get("mounts") or []
        mounts = stated if isinstance(stated, list) else [stated]
        for number, (lidar, times) in enumerate((("lidar", "timing"), ("second_lidar", "second_timing"))):
            delay = (self.summary.get(times) or {}).get("compensated_delay")
            if data[lidar]["delay"] is None and isinstance(delay, float):
                data[lidar]["delay"] = delay
            if number < len(mounts):
                data[lidar]["mount"] = mounts[number]
        return validated_config(data, f"{self.path / SUMMARY}: mounts of a recording")

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


def write_results(directory: Path, finished: Finished, config: Config, summary: dict[str, Any]) -> None:
    """Write the files that are made from the estimate: trajectory, keyframes, map, settings and summary.

    Raises MapError if the estimate has no pose or is not finite.
    """
    stamps = as_recorded(finished.stamps, summary)
    write_tum(directory / TRAJECTORY, Trajectory(finished.stamps, finished.poses), stamps)
    write_keyframes(directory / KEYFRAMES, finished.keyframes)
    write_map(directory / MAP, finished.walls, finished.corners)
    (directory / CONFIG).write_text(config_to_toml(config), encoding="utf-8")
    write_json(directory / SUMMARY, summary)


def read_run_results(path: Path | str) -> RunResults:
    """Read the results in the output directory of a run. Raises MapError naming the file that is missing or invalid."""
    path = Path(path)
    require_results(path)
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


@contextmanager
def refusing_damaged_summary(directory: Path) -> Iterator[None]:
    """Raise MapError that names the summary of an output directory, in place of errors by its damaged entries."""
    file = directory / SUMMARY
    try:
        yield
    except KeyError as error:
        raise MapError(f"{file}: has no {error.args[0]}, which every run writes") from error
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise MapError(f"{file}: is not the summary of a run: {first_line(error)}") from error


def _read_summary(path: Path) -> dict[str, Any]:
    """Read a summary; numbers that are not finite are null, as they would be written again. Raises MapError."""
    summary = to_json_types(read_json(path))
    if not isinstance(summary, dict):
        raise MapError(f"{path}: is not the summary of a run")
    for name, kind in SUMMARY_TYPES.items():
        if not isinstance(summary.get(name) or kind(), kind):
            raise MapError(f"{path}: {name} is not a {'table' if kind is dict else 'list'}")
    if not all(isinstance(row, dict) for name in TABLES for row in summary.get(name) or ()):
        raise MapError(f"{path}: {' or '.join(TABLES)} has an entry that is not a table")
    return summary
