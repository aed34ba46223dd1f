"""Output directories of runs: complete, or not written at all."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ..config import Config, config_to_toml
from ..errors import OutputError
from ..events import Finished
from .atomic_swap import swap_directories
from .keyframes_csv import Keyframes, write_keyframes
from .map_json import write_map
from .recorded_stamps import as_recorded
from .tum import Trajectory, write_tum

TRAJECTORY = "trajectory.tum"
MAP = "map.json"
KEYFRAMES = "keyframes.csv"
CONFIG = "config.toml"
SUMMARY = "summary.json"
REVIEW = "review.rrd"
PICTURE = "map.png"
REPORT = "report.html"
GRAPH = "graph.g2o"
GRAPH_PICTURE = "graph.png"
EXPORTED = "map"
POINTS = "points.ply"
SESSION = "session"
RESULTS = frozenset({TRAJECTORY, KEYFRAMES, MAP, CONFIG, SUMMARY, REVIEW, PICTURE, REPORT, SESSION})
GRAPH_RESULTS = frozenset({GRAPH, GRAPH_PICTURE, SUMMARY})
EXPORTS = frozenset({f"{EXPORTED}.{suffix}" for suffix in ("pgm", "yaml", "geojson", "svg", "dxf", "g2o")} | {POINTS})
"""Files that `wclm map` adds to the directory of a run. They can be made again, so --overwrite removes them, too."""


class OutputDirectory:
    """Context of a temporary directory that is renamed to the output directory if the block ends without an error.

    with OutputDirectory(Path("out"), overwrite=False) as directory:
        write_results(directory, ...)            # a temporary directory beside out, renamed to out at the end

    On an error or Ctrl-C the temporary directory is removed, and `out` does not change. If the process is killed, the
    temporary directory stays. An existing directory is refused unless it is empty or `overwrite` is set, and even then
    if it contains anything that is not a result of a run: a mistyped path must not delete other files.
    Raises OutputError on entering; and on leaving if the results cannot be moved into place, but keeps them then.
    """

    def __init__(self, path: Path, overwrite: bool = False) -> None:
        self._target = path.resolve()
        self._shown = path
        self._overwrite = overwrite
        self._work: Path | None = None

    def __enter__(self) -> Path:
        self._check_target()
        try:
            self._target.parent.mkdir(parents=True, exist_ok=True)
            self._work = Path(tempfile.mkdtemp(prefix=f".{self._target.name}-", dir=self._target.parent))
            self._work.chmod(0o777 & ~_umask())
        except OSError as error:
            raise OutputError(f"{self._shown}: cannot be written: {error.strerror or error}") from error
        return self._work

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        assert self._work is not None
        if kind is None:
            self._move_into_place(self._work)
            return
        shutil.rmtree(self._work, ignore_errors=True)
        if isinstance(error, OSError):
            raise OutputError(f"{self._shown}: cannot be written: {error.strerror or error}") from error

    def _check_target(self) -> None:
        """Raise OutputError if the target exists and must not be replaced."""
        if not self._target.exists():
            return
        if not self._target.is_dir():
            raise OutputError(f"{self._shown}: is a file, not a directory")
        try:
            present = sorted(entry.name for entry in self._target.iterdir())
        except OSError as error:
            raise OutputError(f"{self._shown}: cannot be read: {error.strerror or error}") from error
        if present and not self._overwrite:
            raise OutputError(f"{self._shown}: exists already; choose another directory or add --overwrite")
        foreign = [name for name in present if name not in RESULTS | GRAPH_RESULTS | EXPORTS and not _is_log_part(name)]
        if foreign:
            raise OutputError(f"{self._shown}: contains {foreign[0]}, which is not a result of a run; not overwritten")

    def _move_into_place(self, work: Path) -> None:
        """Rename the temporary directory to the target.

        Older results are exchanged with the new ones atomically: whenever the process is killed, one of the two is in
        place, complete. If the system does not support that, the older ones are renamed first, and back if the new
        ones cannot be renamed.
        """
        try:
            self._check_target()
            if not self._target.exists():
                work.rename(self._target)
                return
            if swap_directories(work, self._target):
                shutil.rmtree(work, ignore_errors=True)
                return
            aside = self._target.rename(work.with_name(f"{work.name}-old"))
            try:
                work.rename(self._target)
            except OSError:
                aside.rename(self._target)
                raise
            shutil.rmtree(aside, ignore_errors=True)
        except (OSError, OutputError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise OutputError(
                f"the results are kept in {work}; they cannot be moved to {self._shown}: {reason}"
            ) from error


@contextmanager
def unfinished_file(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary file beside `path`, renamed to it if the block ends without an error, else removed.

    Raises OutputError if `path` exists and `overwrite` is not set, or if it cannot be written.
    """
    if path.is_dir():
        raise OutputError(f"{path}: is a directory")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no directory {path.parent}")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: exists already; choose another name or add --overwrite")
    work = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield work
        work.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        work.unlink(missing_ok=True)


def write_results(directory: Path, finished: Finished, config: Config, summary: dict[str, Any]) -> None:
    """Write the files that are made from the estimate: trajectory, keyframes, map, settings and summary.

    Raises MapError if the estimate has no pose or is not finite.
    """
    stamps = as_recorded(finished.stamps, summary)
    write_tum(directory / TRAJECTORY, Trajectory(finished.stamps, finished.poses), stamps)
    covariance = finished.keyframe_covariance
    if covariance is None:
        covariance = np.full((len(finished.keyframes), 3, 3), np.nan)
    write_keyframes(directory / KEYFRAMES, Keyframes(finished.keyframe_stamps, finished.keyframes, covariance))
    write_map(directory / MAP, finished.walls, finished.corners)
    (directory / CONFIG).write_text(config_to_toml(config), encoding="utf-8")
    write_json(directory / SUMMARY, summary)


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write `data` as standard JSON: NumPy numbers as plain ones, NaN and infinity as null."""
    path.write_text(json.dumps(to_json_types(data), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def to_json_types(value: Any) -> Any:
    """Return `value` made of JSON's types only; other objects become strings."""
    if isinstance(value, dict):
        return {str(name): to_json_types(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_json_types(value.tolist())
    if isinstance(value, list | tuple):
        return [to_json_types(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | None) else str(value)


def _is_log_part(name: str) -> bool:
    """Return True for a later file of a long review log."""
    return re.fullmatch(r"review-\d+\.rrd", name) is not None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
