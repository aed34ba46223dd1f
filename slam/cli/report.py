"""The summary of a run: as data for summary.json, and as the few lines that a person reads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..io.host import peak_memory, versions

if TYPE_CHECKING:
    from ..evaluation.metrics import ReferenceScore
    from ..events import Finished
    from .session import Feed, Outcome, Tally

SHOWN_WARNINGS = 4


def summarise(
    feed: Feed,
    finished: Finished,
    tally: Tally,
    notices: list[str],
    score: ReferenceScore | None,
    *,
    seed: int | None,
    slam_seconds: float,
    seconds: float,
) -> dict[str, Any]:
    """Everything worth knowing about a run: what went in, what came out, how long it took, what was odd."""
    from ..io.tum import Trajectory

    report = feed.report
    return {
        "recording": feed.name,
        "recording_path": feed.reopen,
        "seed": seed,
        "scans": tally.scans,
        "odometry": len(tally.odometry),
        "duration": tally.duration,
        "keyframes": len(finished.keyframes),
        "walls": len(finished.lines),
        "corners": len(finished.corners),
        "path_length": float(Trajectory(finished.stamps, finished.poses).travelled[-1]),
        "slam_seconds": slam_seconds,
        "wall_seconds": seconds,
        "real_time_factor": tally.duration / slam_seconds,
        "peak_memory_mib": peak_memory(),
        "truth": None if score is None else score.figures(),
        "warnings": notices,
        "skipped": {"messages": report.skipped, "reasons": report.reasons, "first": report.first},
        "slam": finished.summary,
        "versions": versions(),
    } | feed.facts()


def lines_for_people(outcome: Outcome, out: Path) -> list[str]:
    """The summary as a few lines."""
    summary = outcome.summary
    rows = [
        ("map", f"{summary['walls']} walls, {summary['corners']} corners, from {summary['keyframes']} keyframes"),
        ("time", _time(summary)),
    ]
    if truth := summary["truth"]:
        rows.append(
            ("accuracy", f"{truth['ate_rmse']:.3f} m from the true path (ATE RMSE), at most {truth['ate_max']:.3f} m")
        )
    if skipped := summary["skipped"]["messages"]:
        rows.append(("skipped", f"{skipped} messages, the first: {summary['skipped']['first']}"))
    rows += [("device", _device(device)) for device in summary.get("devices", ())]
    left_out = summary.get("review") or {}  # a run without a log has none to tell of
    if any(left_out.values()):
        rows.append(("log", "left out: " + ", ".join(f"{count} {name}" for name, count in left_out.items())))
    rows += [("warning", text) for text in summary["warnings"][:SHOWN_WARNINGS]]
    if (more := len(summary["warnings"]) - SHOWN_WARNINGS) > 0:
        rows.append(("", f"and {more} more warnings in summary.json"))
    rows.append(("results", f"{out}: {', '.join(sorted(entry.name for entry in out.iterdir()))}"))
    if outcome.review:
        rows.append(("look at it", f"wclm review {out}"))
    head = (
        f"{summary['recording']}: {summary['scans']} scans in {summary['duration']:.1f} s, "
        f"{summary['path_length']:.1f} m driven"
    )
    return [head] + [f"  {name:<11}{text}" for name, text in rows]


def _device(device: dict[str, Any]) -> str:
    """How a device did: its messages, and what went wrong."""
    from .monitor import troubles_in_words

    counters = device["counters"]
    return ", ".join([f"{device['spec']}: {counters['messages']} messages", *troubles_in_words(counters)])


def _time(summary: dict[str, Any]) -> str:
    factor = summary["real_time_factor"]
    speed = f"{factor:.0f} times faster than real time" if factor >= 2 else f"{factor:.2f} times real time"
    return (
        f"{summary['slam_seconds']:.1f} s for SLAM, {speed}; {summary['wall_seconds']:.1f} s in all, "
        f"{summary['peak_memory_mib']:.0f} MiB"
    )
