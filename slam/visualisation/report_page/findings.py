"""What looked wrong in a run, in words: from its warnings, its states, its counts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ...io.tum import Trajectory
from .words import clock, counted, percent

LITTLE_EXPLAINED = 0.75
"""Share of a scan's wall that the map explains, at the median. Recordings of offices with people in them have 0.92 to
0.99."""
STRAYING_ODOMETRY = 0.3
"""Metres per metre of way that odometry errs, as it was learned. The wheels of robots in public recordings have 0.06 to
0.12; a lidar that looks backwards without anybody having said so makes it 1.6."""
SHOWN_TIMES = 4
STAMPED = re.compile(r"(?P<text>.*) \(at (?P<stamp>-?\d+(\.\d+)?) s\)", re.DOTALL)
STATES = {
    "LOST": (
        "the robot was lost",
        "It was not where the map had it, and was looked for. What it saw meanwhile was added when it was found.",
    ),
    "DEGENERATE": (
        "the place was open in one direction",
        "As in a bare corridor: along it the path rests on odometry alone, and may be longer or shorter than it was.",
    ),
}
COUNTS = {
    "blind": ("showed too little to place it", "Nothing or little within reach; the path rests on odometry there."),
    "empty_scans": ("had no return at all", "The lidar was covered, or everything was out of its range."),
    "scans_without_odometry": ("came before any odometry and were left out", "The base began to tell later."),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing a person should look at: what it was, in a line, and what it means. `grave` ones may spoil the map."""

    text: str
    detail: str
    grave: bool = False


def findings(summary: dict[str, Any], trajectory: Trajectory) -> list[Finding]:
    """All that looked wrong, the grave first."""
    slam = summary.get("slam") or {}
    found = [
        *_states(slam.get("states") or [], trajectory),
        *_warnings(summary.get("warnings") or [], trajectory),
        *_loops(slam.get("loops") or {}),
        *_health(slam.get("health") or {}),
        *_odometry(slam.get("odometry_deviation_per_metre")),
        *_source(summary),
    ]
    return sorted(found, key=lambda finding: not finding.grave)


def _states(rows: list[dict[str, Any]], trajectory: Trajectory) -> Iterator[Finding]:
    """For how long the robot was in a state that is not OK, and when."""
    ends = [*(row["stamp"] for row in rows), float(trajectory.stamps[-1])][1:]
    for state, (text, detail) in STATES.items():
        spans = [(row["stamp"], end) for row, end in zip(rows, ends, strict=True) if row["state"] == state]
        if spans:
            seconds = sum(end - start for start, end in spans)
            times = _times([start for start, _ in spans], trajectory)
            yield Finding(f"For {seconds:.0f} s in all {text}, {times}.", detail, grave=state == "LOST")


def _warnings(texts: list[str], trajectory: Trajectory) -> Iterator[Finding]:
    """Equal warnings once, with the times at which they came."""
    stamps: dict[str, list[float]] = {}
    for warning in texts:
        stamped = STAMPED.fullmatch(warning)
        at = stamps.setdefault(stamped["text"] if stamped else warning, [])
        if stamped:
            at.append(float(stamped["stamp"]))
    for text, at in stamps.items():
        head = text[:1].upper() + text[1:]
        yield Finding(f"{head}." if not at else f"{head}, {_times(at, trajectory)}.", "")


def _loops(loops: dict[str, int]) -> Iterator[Finding]:
    if retracted := loops.get("retracted", 0):
        yield Finding(
            f"{counted(retracted, 'loop closure')} had to be taken back.",
            "What was seen later contradicted it, so the map was made again without it. Look-alike places cause it.",
        )


def _health(health: dict[str, Any]) -> Iterator[Finding]:
    overlap_ratio = health.get("overlap_ratio_median")
    if overlap_ratio is not None and overlap_ratio < LITTLE_EXPLAINED:
        yield Finding(
            f"The map explains only {percent(overlap_ratio)} of what the scans see.",
            "Too much that moves, a floor or a window in the lidar's plane, or a map that came apart.",
            grave=True,
        )
    for name, (text, detail) in COUNTS.items():
        if count := health.get(name, 0):
            yield Finding(f"{counted(count, 'scan')} {text}.", detail)


def _odometry(deviations: list[float] | None) -> Iterator[Finding]:
    """How far odometry strays from what the scans say; a wrong mount of the lidar looks like that, too."""
    if deviations and deviations[0] > STRAYING_ODOMETRY:
        yield Finding(
            f"Odometry strays by {percent(deviations[0])} of the way.",
            "Wheels that slip, a wrong size of the wheels, or a lidar that is not mounted as `lidar.mount` says.",
            grave=True,
        )


def _source(summary: dict[str, Any]) -> Iterator[Finding]:
    skipped = summary.get("skipped") or {}
    if count := skipped.get("messages", 0):
        reasons = "; ".join(f"{reason}: {times}" for reason, times in (skipped.get("reasons") or {}).items())
        yield Finding(f"{counted(count, 'message')} of the recording could not be used.", reasons)
    factor = summary.get("real_time_factor")
    if factor is not None and factor < 1.0:
        yield Finding(f"SLAM took {1 / factor:.1f} times as long as the drive.", "Live it would not have kept up.")


def _times(stamps: list[float], trajectory: Trajectory) -> str:
    """When, on the clock of the drive; how often, where it was too often to tell all."""
    shown = ", ".join(clock(stamp - trajectory.stamps[0]) for stamp in stamps[:SHOWN_TIMES])
    return f"at {shown}" if len(stamps) <= SHOWN_TIMES else f"{len(stamps)} times, first at {shown}"
