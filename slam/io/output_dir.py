"""Output directories of runs: complete, or not written at all."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from ..errors import MapError, OutputError
from .atomic_swap import exchange_directories, sync_directory, sync_file
from .disk_reserve import MIN_RESERVE, directory_size, free_space
from .work_directory import RunAnnouncement, WorkDirectory, is_being_written

TRAJECTORY = "trajectory.tum"
MAP = "map.json"
KEYFRAMES = "keyframes.csv"
CONFIG = "config.toml"
SUMMARY = "summary.json"
REVIEW = "review.rrd"
PICTURE, CLOSURE_PICTURE = "map.png", "closure.png"
REPORT = "report.html"
GRAPH = "graph.g2o"
GRAPH_PICTURE = "graph.png"
EXPORTED = "map"
MEASURED = "measurements"
POINTS = "points.ply"
SESSION = "session"
PLAN_DIFFERENCES = "plan.geojson"
PLAN_PICTURE = "plan.svg"
RESULTS = frozenset({TRAJECTORY, KEYFRAMES, MAP, CONFIG, SUMMARY, REVIEW, PICTURE, REPORT, SESSION})
DEMO_RESULTS = frozenset({CLOSURE_PICTURE})
PLAN_RESULTS = frozenset({PLAN_DIFFERENCES, PLAN_PICTURE})
GRAPH_RESULTS = frozenset({GRAPH, GRAPH_PICTURE, SUMMARY})
EXPORTS = frozenset(
    {f"{EXPORTED}.{suffix}" for suffix in ("pgm", "yaml", "geojson", "svg", "dxf", "g2o")}
    | {f"{MEASURED}.{suffix}" for suffix in ("csv", "svg", "dxf", "geojson")}
    | {POINTS}
)
"""Files that `wclm map` and `wclm measure` add to the directory of a run. They can be made again, so --overwrite
removes them, too."""


def require_results(path: Path) -> None:
    """Raise MapError unless `path` is a directory, as results of a run are."""
    if not path.is_dir():
        found = "is not a directory" if path.exists() else "no such directory"
        raise MapError(f"{path}: {found}; expected the output directory of `wclm run`")


def refuse_results(recording: str) -> str:
    """Return the name of a recording; raises MapError if it is a directory with the map of a run instead."""
    try:
        has_map = (Path(recording) / MAP).is_file()
    except OSError as error:
        raise MapError(f"{recording}: cannot be read: {error.strerror or error}") from error
    if has_map:
        raise MapError(
            f"{recording}: contains the results of a run and no recording; wclm review {recording} shows them, "
            f"wclm run RECORDING --continue {recording} extends the map, wclm optimize {recording} refines it"
        )
    return recording


class OutputDirectory:
    """Context of a temporary directory that is renamed to the output directory if the block ends without an error.

    with OutputDirectory(Path("out"), overwrite=False) as directory:
        write_results(directory, ...)            # a temporary directory beside out, renamed to out at the end

    On an error or Ctrl-C the temporary directory is removed, and `out` does not change; but after an error, a state
    that was saved with `save` stays. If the process is killed, the temporary directory stays, too. An existing
    directory is refused unless it is empty or `overwrite` is set, and even then if it contains anything that is not a
    result of a run: a mistyped path must not delete other files.
    `reserved` holds disk space for the results, also for larger ones as they grow with the saved states.
    Raises OutputError on entering; and on leaving if the results cannot be moved into place, but keeps them then.
    """

    def __init__(self, path: Path, overwrite: bool = False, *, reserved: bool = False) -> None:
        self.path = path
        self._target = path.resolve()
        self._overwrite, self._reserved = overwrite, reserved
        self._work: WorkDirectory | None = None
        self._control, self._announcing = RunAnnouncement(os.getpid()), threading.Lock()
        self._own: int | None = None  # inode of the target if it is a saved state of this run

    def __enter__(self) -> Path:
        self.check()
        if is_being_written(self._target):
            raise OutputError(f"{self.path}: another run is writing it; choose another directory")
        try:
            self._target.parent.mkdir(parents=True, exist_ok=True)
            self._work = WorkDirectory(self._target)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from error
        if self._reserved:
            self._hold_first_reserve(self._work)
        return self._work.path

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        assert self._work is not None
        work = self._work
        work.reserve.release()
        work.withdraw()
        try:
            if kind is None:
                self._move_into_place(work.path)
            elif kind is KeyboardInterrupt or self._own is None:
                self._discard(work)
            for path in (work.path, work.saved, work.old):
                shutil.rmtree(path, ignore_errors=True)
        finally:
            work.unlock()
        if isinstance(error, OSError):
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from error

    def check(self) -> None:
        """Raise OutputError if the target exists and must not be replaced, which entering does too."""
        if not self._target.exists():
            return
        if not self._target.is_dir():
            raise OutputError(f"{self.path}: is a file, not a directory")
        if self._target.samefile(os.curdir):
            raise OutputError(f"{self.path}: is the current directory, which cannot be replaced; name another one")
        try:
            present = sorted(entry.name for entry in self._target.iterdir())
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be read: {error.strerror or error}") from error
        if present and not self._overwrite and self._target.stat().st_ino != self._own:
            raise OutputError(
                f"{self.path}: exists already; choose another directory or add --overwrite (overwrite=True)"
            )
        foreign = [
            name
            for name in present
            if name not in RESULTS | DEMO_RESULTS | PLAN_RESULTS | GRAPH_RESULTS | EXPORTS and not _is_log_part(name)
        ]
        if foreign:
            raise OutputError(
                f"{self.path}: contains {foreign[0]}, which is not a result of a run; not overwritten: move it, or "
                "choose another directory"
            )

    def announce(self, change: Callable[[RunAnnouncement], RunAnnouncement]) -> None:
        """Change what this process announces to others, which `running_process` reads; may be called in any thread.

        change  returns the new announcement, given the present one
        """
        assert self._work is not None
        with self._announcing, suppress(OSError):
            self._control = change(self._control)
            self._work.announce(self._control)

    def save(self, write: Callable[[Path], None]) -> None:
        """Replace the output directory by a complete state of the run, while the block goes on.

        write  writes the state into a directory

        The new state is on the disk before it replaces the last one, so one of both survives a power failure. Results
        of an earlier run are kept until the block ends. Raises OutputError if the state cannot be written.
        """
        assert self._work is not None
        work, size = self._work, 0
        try:
            shutil.rmtree(work.saved, ignore_errors=True)
            work.saved.mkdir()
            work.reserve.release()
            write(work.saved)
            sync_directory(work.saved)
            size = directory_size(work.saved)
            self.check()
            self._replace_target(work)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be saved: {error.strerror or error}") from error
        finally:
            shutil.rmtree(work.saved, ignore_errors=True)
            if self._reserved:
                work.reserve.hold_up_to(max(MIN_RESERVE, 2 * size))

    def finish(self, write: Callable[[Path], None]) -> None:
        """Write the final results with `write`: into the temporary directory, or another place if that fails.

        Raises OutputError that names the other place, or with the first error if there is none.
        """
        assert self._work is not None
        self._work.reserve.release()
        try:
            write(self._work.path)
        except OSError as error:
            reason = f"{self.path}: cannot be written: {error.strerror or error}"
            other = _write_elsewhere(write, self._target.name)
            if other is None:
                raise OutputError(f"{reason}, nor can the home directory and the temporary one") from error
            for part in (part for part in self._work.path.iterdir() if part.suffix == ".rrd"):
                with suppress(OSError):
                    shutil.copy2(part, other)
            raise OutputError(f"{reason}; the results are in {other} instead") from error

    def _hold_first_reserve(self, work: WorkDirectory) -> None:
        try:
            work.reserve.hold(MIN_RESERVE)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                return  # the file system cannot reserve space
            free = free_space(self._target.parent) / 1e6
            self._discard(work)
            work.unlock()
            reason = f"{free:.0f} MB are free there, and {MIN_RESERVE / 1e6:.0f} MB are needed for the results"
            raise OutputError(f"{self.path}: {reason}") from error

    def _replace_target(self, work: WorkDirectory) -> None:
        """Exchange the target with the saved state; keep the results of an earlier run.

        Those get the name `old` by the exchange itself, as recovery removes `saved` if the process is killed.
        """
        identity = work.saved.stat().st_ino
        if self._target.exists() and self._target.stat().st_ino != self._own:
            work.saved.rename(work.old)
            try:
                exchange_directories(work.old, self._target)
            except OSError:
                work.old.rename(work.saved)
                raise
        else:
            exchange_directories(work.saved, self._target)
        self._own = identity
        sync_file(self._target.parent)

    def _discard(self, work: WorkDirectory) -> None:
        """Remove all results of this run, and restore those of an earlier one."""
        if self._own is not None and self._target.exists() and self._target.stat().st_ino == self._own:
            shutil.rmtree(work.saved, ignore_errors=True)
            self._target.rename(work.saved)
        if work.old.exists() and not self._target.exists():
            work.old.rename(self._target)
        shutil.rmtree(work.path, ignore_errors=True)
        shutil.rmtree(work.saved, ignore_errors=True)

    def _move_into_place(self, work: Path) -> None:
        """Rename the temporary directory to the target.

        Older results are exchanged with the new ones atomically, which are on the disk by then: whenever the process
        is killed or the power fails, one of the two is in place, complete.
        """
        try:
            self.check()
            sync_directory(work)
            exchange_directories(work, self._target)
            sync_file(self._target.parent)
        except (OSError, OutputError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise OutputError(
                f"the results are kept in {work}; they cannot be moved to {self.path}: {reason}"
            ) from error
        shutil.rmtree(work, ignore_errors=True)


def _write_elsewhere(write: Callable[[Path], None], name: str) -> Path | None:
    """Write results into a new directory in the home directory, else the temporary one; None if both fail."""
    for folder in (Path.home(), Path(tempfile.gettempdir())):
        with suppress(OSError):
            other = Path(tempfile.mkdtemp(prefix=f"{name}-", dir=folder))
            try:
                write(other)
            except OSError:
                shutil.rmtree(other, ignore_errors=True)
                raise
            return other
    return None


def _is_log_part(name: str) -> bool:
    """Return True for a later file of a long review log."""
    return re.fullmatch(r"review-\d+\.rrd", name) is not None
