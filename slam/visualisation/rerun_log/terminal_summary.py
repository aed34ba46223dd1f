"""Summarise a session in the terminal: health, loop closures and worst residuals, without a viewer."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rerun.chunk import Chunk

from ...errors import MapError
from ...formatting import counted, percent
from ...io.output_dir import SUMMARY
from ...loop_closure.loop_status import LoopStatus
from ...reporting.log_text import log_losses_text
from ..report_page.findings import warning_lines
from ..report_page.loop_text import by_margin, loops_text, returns_text
from .log_files import LogFiles, find_log
from .loop_layer import DECISIONS
from .rrd_reader import Row, chunks_of, rows
from .status_layer import ENTITY as STATUS_ENTITY

NOT_APPLIED = (LoopStatus.REJECTED,)
SHOWN_REJECTED = 5
SCAN_COUNTS = {"slipped": "slipped", "failed": "failed", "no_features": "without features", "lost": "LOST"}
"""Words for the counts of scans under `health`."""


@dataclass(frozen=True, slots=True)
class SessionData:
    """Summary of a session, empty if the run did not end, and chunks of its log, empty without a log."""

    summary: dict[str, Any]
    chunks: Sequence[Chunk]


def summary_lines(session: Path) -> list[str]:
    """Return the lines for a session or a log. Raises MapError if there is neither."""
    log: LogFiles | None = None
    directory = session
    try:
        log = find_log(session)
        directory = log.directory
    except MapError:
        if not (session / SUMMARY).is_file():
            raise
    data = SessionData(_read_summary(directory / SUMMARY), [] if log is None else list(chunks_of(log.files)))
    lines = [f"{session}: {_headline(data)}"]
    if log is not None and not log.ended:
        lines.append(f"  the run has not ended, or was killed; its log is in {log.directory}")
    return lines + [f"  {line}" for part in (_health(data), _closures(data), _residuals(data)) for line in part]


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise MapError(f"{path}: cannot be read: {error}") from error
    return read if isinstance(read, dict) else {}


def _headline(data: SessionData) -> str:
    if data.summary:
        nouns = ("keyframe", "wall", "corner")
        counts = ", ".join(counted(data.summary.get(f"{noun}s", "?"), noun) for noun in nouns)
        return f"{data.summary.get('recording', '?')}, {counts}"
    keyframes = {row.keyframe for row in rows(data.chunks, "/world/keyframe")}
    return counted(len(keyframes), "keyframe")


def _health(data: SessionData) -> Iterator[str]:
    slam = data.summary.get("slam") or {}
    health = slam.get("health") or {}
    if health:
        ratio = health.get("overlap_ratio_median")  # None: most scans show no walls
        overlap = "" if ratio is None else f"overlap ratio {percent(ratio)} (median of the scans); "
        counts = ", ".join(f"{health.get(key, 0)} {text}" for key, text in SCAN_COUNTS.items())
        yield f"health      {overlap}scans: {counts}"
    else:
        shares = [row.values["Scalars:scalars"][0] for row in rows(data.chunks, "/metrics/overlap_ratio")]
        known = sorted(share for share in shares if not math.isnan(share))
        if known:
            yield f"health      overlap ratio {percent(known[len(known) // 2])} (median of the keyframes)"
    changes = [row.values["StateChange:state"][0] for row in rows(data.chunks, f"/{STATUS_ENTITY}")]
    counts_by_status = Counter(status for status in changes if status != "OK")
    states = (
        ", ".join(f"{counted(count, 'time')} {status}" for status, count in counts_by_status.items()) or "OK throughout"
    )
    if changes:
        yield f"status      {states}"
    if losses := log_losses_text(data.summary.get("review") or {}):
        yield f"log         {losses}"
    warnings = warning_lines(data.summary.get("warnings") or [], data.summary.get("start", 0.0))
    for text in warnings[:3]:
        yield f"warning     {text}"
    if len(warnings) > 3:
        yield f"            and {len(warnings) - 3} more"


def _closures(data: SessionData) -> Iterator[str]:
    decisions = list(_decisions(data))
    counts = Counter(decision["status"] for decision in decisions)
    slam = data.summary.get("slam") or {}
    if returns := returns_text(slam):
        yield f"returns     {returns}"
    yield "loops       " + (loops_text(slam) or ", ".join(f"{n} {status}" for status, n in counts.items()) or "none")
    for decision in decisions:
        if decision["status"] not in NOT_APPLIED:
            effect = f"moved by {decision['shift']:.2f} m, {counted(decision['merged'], 'wall')} merged"
            reason = f": {decision['reason']}" if decision["status"] == LoopStatus.RETRACTED else ""
            yield f"  {decision['status']:<10}{_named(decision)}, {effect}{reason}"
    for decision in by_margin([decision for decision in decisions if decision["status"] in NOT_APPLIED])[
        :SHOWN_REJECTED
    ]:
        yield f"  rejected  {_named(decision)}: {decision['reason']}"


def _named(decision: dict[str, Any]) -> str:
    """Return the number of a loop, as `wclm correct` takes it, and its keyframes."""
    return f"loop {decision['candidate']}, x{decision['keyframe']} at x{decision['old']}"


def _decisions(data: SessionData) -> Iterator[dict[str, Any]]:
    """Yield the decisions from the log, which contains the checks; without a log from the summary."""
    found = rows(data.chunks, f"/{DECISIONS}")
    if not found:
        yield from (data.summary.get("slam") or {}).get("loop_decisions") or []
    for row in found:
        value = {name: values[0] for name, values in row.values.items() if values}
        yield {
            "status": value["status"],
            "candidate": value["loop"],
            "keyframe": value["at_keyframe"],
            "old": value["old_keyframe"],
            "reason": value["reason"],
            "shift": value.get("max_shift", value["shift"]),
            "merged": value["merged"],
            "margin": value.get("margin"),
        }


def _residuals(data: SessionData) -> Iterator[str]:
    inspected: list[Row] = rows(data.chunks, "/residuals/worst")
    if not inspected:
        yield f"residuals   unknown: {'not in this log' if data.chunks else 'there is no log'}"
        return
    worst = inspected[-1]
    yield f"residuals   worst factors at keyframe {worst.keyframe} (x: keyframe, L: wall, c: corner)"
    columns = (worst.values[name] for name in ("factor", "kind", "squared", "dof"))
    for factor, kind, squared, dof in zip(*columns, strict=True):
        yield f"  {factor:<16}{kind:<15}d² = {squared:.1f}, {dof} dof"
