"""Locate the files of a review log, also of a run that has not ended or was killed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ...errors import MapError
from ...io.output_dir import REVIEW


@dataclass(frozen=True, slots=True)
class LogFiles:
    """Files of one log, in order, and the directory of its run. `ended` is True if the run has ended."""

    directory: Path
    files: tuple[Path, ...]
    ended: bool


def part_name(path: Path, number: int) -> Path:
    """Return `review.rrd`, `review-2.rrd`, ... for part numbers from 1."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def log_parts(path: Path) -> tuple[Path, ...]:
    """Return the existing files of a log whose first file is `path`, in order."""
    if not path.parent.is_dir():
        return ()
    numbered = re.compile(rf"{re.escape(path.stem)}-(\d+){re.escape(path.suffix)}")
    matches = [(found, entry) for entry in path.parent.iterdir() if (found := numbered.fullmatch(entry.name))]
    later = sorted((int(found[1]), entry) for found, entry in matches)
    return (path,) * path.is_file() + tuple(entry for _, entry in later)


def find_log(session: Path) -> LogFiles:
    """Return the log of a session.

    `session` is the session's directory, a log file, or the output directory of a run that has not ended or was killed.
    The log of such a run is in the hidden directory beside it, in which results are written; the latest one is used.

    Raises MapError if there is no log.
    """
    if session.is_file():
        return LogFiles(session.parent, log_parts(session), ended=True)
    if files := log_parts(session / REVIEW):
        return LogFiles(session, files, ended=not session.name.startswith("."))
    target = session.resolve()
    hidden = target.parent.glob(f".{target.name}-*/{REVIEW}") if target.parent.is_dir() else ()
    found = sorted(hidden, key=lambda log: log.stat().st_mtime)
    if not found and session.is_dir() and any(session.iterdir()):
        raise MapError(f"{session}: contains no {REVIEW}; a run writes one unless --no-review is given")
    if not found:
        raise MapError(f"{session}: no such session, and no unfinished run that would write it")
    return LogFiles(found[-1].parent, log_parts(found[-1]), ended=False)
