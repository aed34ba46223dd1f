"""A review log read back: its rows, whoever wrote it, and whether or not it was finished."""

from __future__ import annotations

import subprocess
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rerun.chunk import Chunk, RrdReader

from ...errors import MapError
from .binary import viewer_binary

ROW = "rerun.controls.RowId"
"""The column of the rows' identities; their bytes are in the order of logging."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of an entity: its keyframe (None where it lies between keyframes) and its components by name."""

    keyframe: int | None
    values: dict[str, Any]


def chunks_of(files: Sequence[Path]) -> Iterator[Chunk]:
    """All chunks of a log's files. One that was cut off, or is of an older version of the viewer, is mended first.

    Raises MapError where a file is no log, or there is nothing in it.
    """
    for path in files:
        with TemporaryDirectory(prefix="wclm-") as scratch:
            yield from _readable(path, Path(scratch) / "mended.rrd").stream()


def recording_id(files: Sequence[Path]) -> str:
    """Of the log. Raises MapError as above."""
    with TemporaryDirectory(prefix="wclm-") as scratch:
        recordings = _readable(files[0], Path(scratch) / "mended.rrd").recordings()
    if not recordings:
        raise MapError(f"{files[0]}: there is nothing in it")
    return str(recordings[0].recording_id)


def rows(chunks: Sequence[Chunk], entity: str) -> list[Row]:
    """The rows of an entity, in the order in which they were logged, without those that hold for all times."""
    found: list[tuple[bytes, Row]] = []
    for chunk in chunks:
        if chunk.entity_path != entity or chunk.is_static:
            continue
        for row in chunk.to_record_batch().to_pylist():
            values = {name: value for name, value in row.items() if isinstance(value, list)}
            found.append((row[ROW], Row(row.get("keyframe"), values)))
    return [row for _, row in sorted(found, key=lambda pair: pair[0])]


def _readable(path: Path, mended: Path) -> RrdReader:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # one that was cut off has no footer
            reader = RrdReader(path)
            reader.recordings()  # goes through the file
        return reader
    except (RuntimeError, ValueError, OSError):
        return _mended(path, mended)


def _mended(path: Path, mended: Path) -> RrdReader:
    """As far as it can be read: the viewer's own tool goes on past an end in the middle of a message."""
    command = [viewer_binary(), "rrd", "merge", "--continue-on-error", str(path), "-o", str(mended)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        reader = RrdReader(mended)
        if done.returncode == 0 and reader.recordings():
            return reader
    except (RuntimeError, ValueError, OSError):
        pass
    raise MapError(f"{path}: is not a review log, or nothing of it can be read")
