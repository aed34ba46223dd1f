"""Logs made ready for the viewer: whole, in one file, and laid out as logs are today."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from .blueprint import Extent, layout, side_by_side
from .files import LogFiles
from .reading import chunks_of, recording_id, rows
from .recording import APPLICATION
from .shapes import bounds

TIME = "sensor_time"


def make_ready(logs: Sequence[LogFiles], names: Sequence[str], target: Path) -> None:
    """Write one log, or several side by side, to `target`, with the layout of this version.

    `names` of the logs are shown where there are several. Raises MapError where one cannot be read.
    """
    if len(logs) == 1:
        chunks = list(chunks_of(logs[0].files))
        _write(target, recording_id(logs[0].files), chunks, layout(extent_of(chunks)))
        return
    whole = dict(zip(_roots(names), (list(chunks_of(log.files)) for log in logs), strict=True))
    clocks = {clock for chunks in whole.values() for clock in _clocks(chunks)}
    moved = [chunk for root, chunks in whole.items() for chunk in _below(root, chunks, timed=len(clocks) < 2)]
    extents = {root: extent_of(chunks) for root, chunks in whole.items()}
    _write(target, " ".join(whole), moved, side_by_side(extents))


def extent_of(chunks: Sequence[Chunk]) -> Extent:
    """What a log shows, as far as it goes."""
    points = [np.empty((0, 2))]
    for entity in ("/world/map/walls", "/world/path/estimate", "/world/path/recent"):
        drawn = [row.values["LineStrips3D:strips"] for row in rows(chunks, entity)]
        points += [np.array(strip)[:, :2] for strip in (drawn[-1] if drawn else [])]
    times = [row.values["Scalars:scalars"][0] for row in rows(chunks, "/metrics/time")]
    truth = any(chunk.entity_path == "/metrics/error" for chunk in chunks)
    usual = float(np.percentile(times, 98)) if times else None
    return Extent(*bounds(*points), truth=truth, usual_time=usual)


def _write(target: Path, identity: str, chunks: Sequence[Chunk], shown: rrb.Blueprint) -> None:
    stream = rr.RecordingStream(APPLICATION, recording_id=identity, send_properties=False)
    stream.set_sinks(rr.FileSink(target))
    stream.send_blueprint(shown)
    stream.send_chunks(chunks)
    stream.flush()
    stream.disconnect()


def _roots(names: Sequence[str]) -> list[str]:
    """Names that entities can have, each once."""
    roots: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_.-]", "_", name) or "log"
        roots.append(plain if plain not in roots else f"{plain}-{len(roots) + 1}")
    return roots


def _below(root: str, chunks: Sequence[Chunk], *, timed: bool) -> Iterator[Chunk]:
    """All chunks with their entities below a root; not `timed`: without the recording's time, and what only has that.

    Logs that tell the time of day and logs that count from their start have no time in common.
    """
    for chunk in chunks:
        if chunk.entity_path.startswith("/__"):  # properties are of a whole recording
            continue
        if not timed and TIME in chunk.timeline_names:
            if len(chunk.timeline_names) == 1:
                continue
            (chunk,) = Chunk.from_record_batch(chunk.to_record_batch().drop_columns([TIME]))
        yield chunk.with_entity_path(f"/{root}{chunk.entity_path}")


def _clocks(chunks: Sequence[Chunk]) -> set[str]:
    """The types of the recording's time: since 1970, or since its start."""
    schemas = (chunk.to_record_batch().schema for chunk in chunks if TIME in chunk.timeline_names)
    return {str(schema.field(TIME).type) for schema in schemas}
