"""Hidden directories in which runs write their results beside the output directory, and what killed runs left there.

A running process holds a lock on its directory, which ends with the process in whatever way it ends.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from .disk_reserve import DiskReserve

CONTROL = "running.json"
"""File in the directory of a run that saves on SIGUSR1 and changes its mode on SIGUSR2, see `RunAnnouncement`."""

MAX_PROBLEM, CONTROL_SIZE = 400, 8192
"""Characters of a problem, of which JSON needs at most six bytes each, and bytes of the file."""
RESERVE = "reserve"
"""File in the directory of a run that holds disk space."""


@dataclass(frozen=True, slots=True)
class RunAnnouncement:
    """What other processes know of a run.

    process        its number
    saves          how often it was requested to save, and did so or could not
    save_problem   why the last save failed; empty if it did not
    frozen         True if the map is only localised in, False if it is extended; None before signals are handled
    switches       how often its mode was requested to change
    switch_problem why the mode was not changed the last time; empty if it was
    """

    process: int
    saves: int = 0
    save_problem: str = ""
    frozen: bool | None = None
    switches: int = 0
    switch_problem: str = ""


class WorkDirectory:
    """Locked hidden directory beside `target`. Raises OSError if it cannot be created.

    path     of the directory
    saved    directory beside it in which a state of the run is built before it replaces the target
    old      directory beside it to which results of an earlier run are moved
    reserve  disk space beside it
    """

    def __init__(self, target: Path) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
        self.path.chmod(0o777 & ~_umask())
        self.saved, self.old = sibling_directories(self.path)
        self.reserve = DiskReserve(self.path / RESERVE)
        self._lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        with suppress(OSError):  # some network file systems have no locks
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def unlock(self) -> None:
        """End the lock; further calls do nothing."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def announce(self, control: RunAnnouncement) -> None:
        """State that this process handles signals, and how it answered them."""
        problems = {
            "save_problem": control.save_problem[:MAX_PROBLEM],
            "switch_problem": control.switch_problem[:MAX_PROBLEM],
        }
        text = json.dumps(asdict(control) | problems)
        descriptor = os.open(self.path / CONTROL, os.O_WRONLY | os.O_CREAT, 0o666)
        try:  # overwritten in place, which needs no space on a full disk
            os.pwrite(descriptor, text.ljust(CONTROL_SIZE).encode(), 0)
        finally:
            os.close(descriptor)

    def withdraw(self) -> None:
        """Remove the statement of `announce`."""
        (self.path / CONTROL).unlink(missing_ok=True)


def sibling_directories(path: Path) -> tuple[Path, Path]:
    """Return the directories `saved` and `old` of the work directory `path`."""
    return path.with_name(f"{path.name}-new"), path.with_name(f"{path.name}-old")


def left_behind(target: Path) -> list[Path]:
    """Return the directories that killed runs with the output directory `target` left beside it, latest first."""
    return [entry for entry in _work_directories(target) if not _is_locked(entry)]


def is_being_written(target: Path) -> bool:
    """Return True if a run is writing the output directory `target`."""
    return any(_is_locked(entry) for entry in _work_directories(target))


def running_process(target: Path) -> RunAnnouncement | None:
    """Return what the process that writes to `target` announced; None if none runs that saves on SIGUSR1."""
    for entry in _work_directories(target):
        if _is_locked(entry):
            with suppress(OSError, ValueError, TypeError):
                control = RunAnnouncement(**json.loads((entry / CONTROL).read_text(encoding="utf-8")))
                if isinstance(control.process, int):
                    return control
    return None


def _work_directories(target: Path) -> list[Path]:
    target = target.resolve()
    if not target.parent.is_dir():
        return []
    pattern = re.compile(rf"\.{re.escape(target.name)}-[a-z0-9_]{{8}}")
    # A link is none: it may have come with a map from elsewhere, and lead to any directory.
    named = [entry for entry in target.parent.iterdir() if pattern.fullmatch(entry.name)]
    found = [entry for entry in named if entry.is_dir() and not entry.is_symlink()]
    return sorted(found, key=lambda entry: entry.stat().st_mtime, reverse=True)


def _is_locked(path: Path) -> bool:
    try:
        lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(lock)
    return False


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
