"""The summary of a run: as data for summary.json, and as the few lines that a person reads."""

from __future__ import annotations

import os
import platform
import resource
import sys
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .viewer import viewer_command

if TYPE_CHECKING:
    from ..evaluation import ReferenceScore
    from ..events import Finished
    from .session import Feed, Outcome, Tally

PACKAGES = ("wclm-slam", "numpy", "numba", "gtsam", "rerun-sdk")
SHOWN_WARNINGS = 4
CPU_LIST = Path("/proc/cpuinfo")
"""Where Linux tells the processor's name, which Python does not ask for."""
MEMORY_STATUS = Path("/proc/self/status")
"""Where Linux tells the memory of this program alone; what getrusage tells includes the one that started it."""


def versions() -> dict[str, str]:
    """Versions of this program and of what its results depend on."""
    return {name: metadata.version(name) for name in PACKAGES} | {"python": platform.python_version()}


def machine() -> dict[str, str | int]:
    """What the times were taken on."""
    model = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = CPU_LIST.read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    return {"processor": model, "cores": os.cpu_count() or 1, "system": platform.system()}


def peak_memory() -> float:
    """The most memory this process has had, MiB."""
    with suppress(OSError, StopIteration):
        lines = MEMORY_STATUS.read_text(encoding="utf-8").splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM:")).split()[1]) / (1 << 10)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


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
    from ..trajectory import Trajectory

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
    rows += [("warning", text) for text in summary["warnings"][:SHOWN_WARNINGS]]
    if (more := len(summary["warnings"]) - SHOWN_WARNINGS) > 0:
        rows.append(("", f"and {more} more warnings in summary.json"))
    rows.append(("results", f"{out}: {', '.join(sorted(entry.name for entry in out.iterdir()))}"))
    if outcome.review:
        rows.append(("look at it", " ".join(viewer_command(out))))
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
