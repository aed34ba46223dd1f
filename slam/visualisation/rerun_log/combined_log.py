"""Write one log, or several side by side, to a single file with the current layout."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from .blueprint import Extent, layout, side_by_side
from .log_files import LogFiles
from .loop_layer import TABLE
from .rrd_reader import chunks_of, recording_id, rows
from .rrd_writer import APPLICATION
from .shapes import bounds
from .timelines import CANDIDATE, CLOSURE, SENSOR_TIME


def write_combined_log(logs: Sequence[LogFiles], names: Sequence[str], target: Path) -> None:
    """Write one log, or several side by side, to `target`, with the layout of this version.

    `names` of the logs are shown if there are several. Raises MapError if one cannot be read.
    """
    if len(logs) == 1:
        chunks = list(chunks_of(logs[0].files))
        _write(target, recording_id(logs[0].files), chunks, layout(extent_of(chunks)))
        return
    by_root = dict(zip(_root_entities(names), (list(chunks_of(log.files)) for log in logs), strict=True))
    time_types = {kind for chunks in by_root.values() for kind in _time_types(chunks)}
    one_clock = len(time_types) < 2
    moved = [chunk for root, chunks in by_root.items() for chunk in _move_below(root, chunks, with_time=one_clock)]
    extents = {root: extent_of(chunks) for root, chunks in by_root.items()}
    _write(target, " ".join(by_root), moved, side_by_side(extents))


def extent_of(chunks: Sequence[Chunk]) -> Extent:
    """Return the extent of the content of a log, finished or not."""
    points = [np.empty((0, 2))]
    for entity in ("/world/map/walls", "/world/path/estimate", "/world/path/recent"):
        drawn = [row.values["LineStrips3D:strips"] for row in rows(chunks, entity)]
        points += [np.array(strip)[:, :2] for strip in (drawn[-1] if drawn else [])]
    times = [row.values["Scalars:scalars"][0] for row in rows(chunks, "/metrics/time")]
    truth = any(chunk.entity_path == "/metrics/error" for chunk in chunks)
    typical = float(np.percentile(times, 98)) if times else None
    decided = any(CANDIDATE in chunk.timeline_names for chunk in chunks if chunk.entity_path == f"/{TABLE}")
    corrected = any(chunk.entity_path == "/world/shift" for chunk in chunks if CLOSURE in chunk.timeline_names)
    fits = [row.values["Scalars:scalars"][0] for row in rows(chunks, "/metrics/chi2")]
    fitted = int(np.isfinite(fits).sum()) > 1
    mapped = len({row.keyframe for row in rows(chunks, "/world/keyframe/scan")}) > 1
    return Extent(*bounds(*points), truth, typical, decided, corrected, fitted, mapped)


def _write(target: Path, identity: str, chunks: Sequence[Chunk], blueprint: rrb.Blueprint) -> None:
    stream = rr.RecordingStream(APPLICATION, recording_id=identity, send_properties=False)
    stream.set_sinks(rr.FileSink(target))
    stream.send_blueprint(blueprint)
    stream.send_chunks(chunks)
    stream.flush()
    stream.disconnect()


def _root_entities(names: Sequence[str]) -> list[str]:
    """Return unique names that are valid entity names."""
    roots: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_.-]", "_", name) or "log"
        roots.append(plain if plain not in roots else f"{plain}-{len(roots) + 1}")
    return roots


def _move_below(root: str, chunks: Sequence[Chunk], *, with_time: bool) -> Iterator[Chunk]:
    """Yield all chunks with their entities below a root.

    Without `with_time`, the sensor time is dropped, and chunks that have no other timeline with it: time of day in one
    log and time since the start in another cannot be shown on one timeline.
    """
    for chunk in chunks:
        if chunk.entity_path.startswith("/__"):  # properties of the whole recording
            continue
        if not with_time and SENSOR_TIME in chunk.timeline_names:
            if len(chunk.timeline_names) == 1:
                continue
            (chunk,) = Chunk.from_record_batch(chunk.to_record_batch().drop_columns([SENSOR_TIME]))
        yield chunk.with_entity_path(f"/{root}{chunk.entity_path}")


def _time_types(chunks: Sequence[Chunk]) -> set[str]:
    """Return the data types of the sensor time: time of day, or time since the start."""
    schemas = (chunk.to_record_batch().schema for chunk in chunks if SENSOR_TIME in chunk.timeline_names)
    return {str(schema.field(SENSOR_TIME).type) for schema in schemas}
