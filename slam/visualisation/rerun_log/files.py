"""Which files a review log is in, and where those of a run are that did not end."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ...errors import MapError
from ...io.output_dir import REVIEW


@dataclass(frozen=True, slots=True)
class LogFiles:
    """The files of one log, in their order, and the directory that it is of. `ended` is whether its run did."""

    directory: Path
    files: tuple[Path, ...]
    ended: bool


def part_name(path: Path, number: int) -> Path:
    """`review.rrd`, `review-2.rrd`, ... for the numbers from 1."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def parts_of(path: Path) -> tuple[Path, ...]:
    """The files of a log that begins with `path`, in their order; those that are there."""
    if not path.parent.is_dir():
        return ()
    numbered = re.compile(rf"{re.escape(path.stem)}-(\d+){re.escape(path.suffix)}")
    matches = [(found, entry) for entry in path.parent.iterdir() if (found := numbered.fullmatch(entry.name))]
    later = sorted((int(found[1]), entry) for found, entry in matches)
    return (path,) * path.is_file() + tuple(entry for _, entry in later)


def find_log(session: Path) -> LogFiles:
    """The log of a session: its directory, a log file itself, or the directory that a run was to leave which has not
    ended or was killed. Then its log is in the hidden directory beside, in which results are made; the latest one.

    Raises MapError where there is none.
    """
    if session.is_file():
        return LogFiles(session.parent, parts_of(session), ended=True)
    if files := parts_of(session / REVIEW):
        return LogFiles(session, files, ended=not session.name.startswith("."))
    if session.is_dir() and any(session.iterdir()):
        raise MapError(f"{session}: holds no {REVIEW}; without --no-review a run writes one")
    target = session.resolve()
    hidden = target.parent.glob(f".{target.name}-*/{REVIEW}") if target.parent.is_dir() else ()
    found = sorted(hidden, key=lambda log: log.stat().st_mtime)
    if not found:
        raise MapError(f"{session}: is not there, nor a run that was to make it")
    return LogFiles(found[-1].parent, parts_of(found[-1]), ended=False)
