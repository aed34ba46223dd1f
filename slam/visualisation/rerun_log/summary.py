"""A session in the terminal: how it went, its closures and its worst residuals, without any viewer."""

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
from ...io.output_dir import SUMMARY
from .files import LogFiles, find_log
from .reading import Row, chunks_of, rows

NOT_CLOSED = ("held", "rejected")


@dataclass(frozen=True, slots=True)
class Told:
    """What is known of a session: its summary, empty where its run did not end, and its log, empty without one."""

    summary: dict[str, Any]
    chunks: Sequence[Chunk]


def summary_lines(session: Path) -> list[str]:
    """The lines for a session or a log. Raises MapError where there is neither."""
    log: LogFiles | None = None
    directory = session
    try:
        log = find_log(session)
        directory = log.directory
    except MapError:
        if not (session / SUMMARY).is_file():
            raise
    told = Told(_read_summary(directory / SUMMARY), [] if log is None else list(chunks_of(log.files)))
    lines = [f"{session}: {_what(told)}"]
    if log is not None and not log.ended:
        lines.append(f"  the run has not ended, or was killed; its log is in {log.directory}")
    return lines + [f"  {line}" for part in (_health(told), _closures(told), _residuals(told)) for line in part]


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise MapError(f"{path}: cannot be read: {error}") from error
    return read if isinstance(read, dict) else {}


def _what(told: Told) -> str:
    if told.summary:
        counts = ", ".join(f"{told.summary.get(name, '?')} {name}" for name in ("keyframes", "walls", "corners"))
        return f"{told.summary.get('recording', '?')}, {counts}"
    keyframes = {row.keyframe for row in rows(told.chunks, "/world/keyframe")}
    return f"{len(keyframes)} keyframes"


def _health(told: Told) -> Iterator[str]:
    slam = told.summary.get("slam") or {}
    health = slam.get("health") or {}
    if health:
        overlap_ratio = 100 * (health.get("overlap_ratio_median") or 0.0)
        counts = ", ".join(f"{health.get(name, 0)} {name}" for name in ("searched", "unplaced", "blind", "lost"))
        yield f"health      the map explains {overlap_ratio:.0f} % of a scan (median); scans: {counts}"
    else:
        shares = [row.values["Scalars:scalars"][0] for row in rows(told.chunks, "/metrics/explained")]
        known = sorted(share for share in shares if not math.isnan(share))
        if known:
            yield f"health      the map explains {100 * known[len(known) // 2]:.0f} % of a keyframe (median)"
    changes = [row.values["StateChange:state"][0] for row in rows(told.chunks, "/state")]
    times = Counter(state for state in changes if state != "OK")
    states = ", ".join(f"{count} times {state}" for state, count in times.items()) or "OK throughout"
    if changes:
        yield f"state       {states}"
    review = told.summary.get("review") or {}
    if any(review.values()):
        yield "log         " + ", ".join(f"{count} events {name}" for name, count in review.items() if count)
    warnings = told.summary.get("warnings") or []
    for text in warnings[:3]:
        yield f"warning     {text}"
    if len(warnings) > 3:
        yield f"            and {len(warnings) - 3} more"


def _closures(told: Told) -> Iterator[str]:
    decisions = list(_decisions(told))
    counts = Counter(decision["status"] for decision in decisions)
    if not decisions:
        yield "loops       no place looked known"
        return
    yield "loops       " + ", ".join(f"{count} {status}" for status, count in counts.items())
    for decision in decisions:
        if decision["status"] not in NOT_CLOSED:
            effect = f"moved by {decision['shift']:.2f} m, {decision['merged']} walls merged"
            reason = f": {decision['reason']}" if decision["status"] == "retracted" else ""
            yield f"  {decision['status']:<10}x{decision['keyframe']} at x{decision['old']}, {effect}{reason}"
    refused = Counter(decision["failed"] for decision in decisions if decision.get("failed"))
    if refused:
        yield "  refused for " + ", ".join(f"{name} ({count})" for name, count in refused.most_common())


def _decisions(told: Told) -> Iterator[dict[str, Any]]:
    """From the log, which knows the tests; else from the summary."""
    found = rows(told.chunks, "/loops/events")
    if not found:
        yield from (told.summary.get("slam") or {}).get("loop_decisions") or []
    for row in found:
        value = {name: values[0] for name, values in row.values.items() if values}
        yield {
            "status": value["status"],
            "keyframe": value["at_keyframe"],
            "old": value["old_keyframe"],
            "reason": value["reason"],
            "shift": value.get("max_shift", value["shift"]),
            "merged": value["merged"],
            "failed": value.get("failed_test", ""),
        }


def _residuals(told: Told) -> Iterator[str]:
    inspected: list[Row] = rows(told.chunks, "/residuals/worst")
    if not inspected:
        yield f"residuals   not known: {'they are not in this log' if told.chunks else 'there is no log'}"
        return
    worst = inspected[-1]
    yield "residuals   the worst at keyframe " + str(worst.keyframe)
    columns = (worst.values[name] for name in ("factor", "kind", "squared", "freedom"))
    for factor, kind, squared, freedom in zip(*columns, strict=True):
        yield f"  {factor:<16}{kind:<11}d² = {squared:.1f} for {freedom} number{'s' if freedom > 1 else ''}"
