"""Read the rows of a review log, also of one whose run was killed while writing it."""

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
from .timelines import SENSOR_TIME
from .viewer import viewer_executable

ROW_ID = "rerun.controls.RowId"
"""Column of the row ids; their bytes sort in the order of logging."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of an entity: its keyframe (None between keyframes) and its components by name."""

    keyframe: int | None
    values: dict[str, Any]


def chunks_of(files: Sequence[Path]) -> Iterator[Chunk]:
    """Yield all chunks of a log's files; a truncated file, or one of an older viewer version, is repaired first.

    Raises MapError if a file is not a log or is empty.
    """
    for path in files:
        with TemporaryDirectory(prefix="wclm-") as scratch:
            yield from _open(path, Path(scratch) / "repaired.rrd").stream()


def recording_id(files: Sequence[Path]) -> str:
    """Return the recording id of a log. Raises MapError as `chunks_of` does."""
    with TemporaryDirectory(prefix="wclm-") as scratch:
        recordings = _open(files[0], Path(scratch) / "repaired.rrd").recordings()
    if not recordings:
        raise MapError(f"{files[0]}: contains no recording")
    return str(recordings[0].recording_id)


def rows(chunks: Sequence[Chunk], entity: str) -> list[Row]:
    """Return the rows of an entity in the order of logging, without static ones and those that a step repeats."""
    found: list[tuple[bytes, Row]] = []
    for chunk in chunks:
        if chunk.entity_path != entity or SENSOR_TIME not in chunk.timeline_names:
            continue
        for row in chunk.to_record_batch().to_pylist():
            values = {name: value for name, value in row.items() if isinstance(value, list)}
            found.append((row[ROW_ID], Row(row.get("keyframe"), values)))
    return [row for _, row in sorted(found, key=lambda pair: pair[0])]


def _open(path: Path, repaired: Path) -> RrdReader:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a truncated file has no footer
            reader = RrdReader(path)
            reader.recordings()  # reads the whole file
        return reader
    except (RuntimeError, ValueError, OSError):
        return _repair(path, repaired)


def _repair(path: Path, repaired: Path) -> RrdReader:
    """Copy the readable part with the viewer's own tool, which skips a message that is cut off."""
    command = [viewer_executable(), "rrd", "merge", "--continue-on-error", str(path), "-o", str(repaired)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        reader = RrdReader(repaired)
        if done.returncode == 0 and reader.recordings():
            return reader
    except (RuntimeError, ValueError, OSError):
        pass
    raise MapError(f"{path}: not a review log, or not readable")
