"""List possible problems of a run, from its warnings, its localisation status and its counts."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from drivers.elapsed import elapsed

from ...checks.suspect import MAP, ODOMETRY, PARTS, PLACEMENT, UNCONSTRAINED
from ...formatting import counted, percent
from ...io.tum import Trajectory
from ...loop_closure.loop_status import LoopStatus

LOW_OVERLAP_RATIO = 0.75
"""Median overlap ratio below which the map is suspicious. Recordings of offices with people have 0.92 to 0.99."""
HIGH_ODOMETRY_ERROR = 0.3
"""Estimated odometry error, metres per metre travelled, above which something is wrong. Robots in public recordings
have 0.06 to 0.12; a lidar mounted backwards without a matching `lidar.mount` causes 1.6."""
MOUNT_ERRORS = {"x": 0.05, "y": 0.05, "heading": 0.03}
"""Errors of the lidar's mount, metres and radians, above which they are reported: those of a ruler, and of the eye."""
MAX_SCALE = 1.25
"""Factor by which odometry may over- or underestimate lengths or turns before it is reported. Worn wheels and carpets
cause some per cent; more is a wrong wheel size, encoder resolution or wheel distance, or tracks that skid in turns."""
MAX_SHOWN_TIMES = 4
MAX_SHOWN_SUSPECTS = 10
SUSPECT_DETAILS = {
    PLACEMENT: "From there on, the path may be displaced or turned.",
    MAP: "Walls may be doubled, or a part of the map may be displaced.",
    PARTS: "The robot lost its pose there, and did not recognise the place later. Parts may be displaced or turned.",
    UNCONSTRAINED: "Its length there is a guess: the robot may have stopped, or driven faster.",
    ODOMETRY: "The scans were enough to correct it, or the path is wrong from there on.",
}
STAMPED = re.compile(r"(?P<text>.*) \(at (?P<stamp>-?\d+(\.\d+)?) s\)", re.DOTALL)
STATUS_FINDINGS = {
    "LOST": (
        "the robot was lost",
        "Its pose in the map was unknown. It was mapping a new part of the map, which is joined if it is recognised.",
    ),
    "DEGENERATE": (
        "one direction was degenerate",
        "As in a bare corridor: the scans do not show how far along it the robot is, and distances may be wrong.",
    ),
}
COUNT_FINDINGS = {
    "no_features": ("had no features", "Nothing or little within range; the path there is from odometry."),
    "empty_scans": ("had no return at all", "The lidar was covered, or everything was out of its range."),
    "scans_without_odometry": ("came before any odometry and were left out", "The base started later."),
}


@dataclass(frozen=True, slots=True)
class Finding:
    """A possible problem: what happened, in a line, and its meaning.

    grave  True if it may have spoilt the map
    stamp  when it happened first, seconds; None if it concerns the whole run
    """

    text: str
    detail: str
    grave: bool = False
    stamp: float | None = None


def findings(summary: dict[str, Any], trajectory: Trajectory) -> list[Finding]:
    """Return the findings of a run, grave ones first."""
    slam = summary.get("slam") or {}
    found = [
        *_wall_findings(summary),
        *_suspect_findings(slam.get("suspects") or [], trajectory),
        *_status_findings(slam.get("states") or [], trajectory, searched=searched_at_start(summary) > 0.0),
        *_warning_findings(summary.get("warnings") or [], trajectory),
        *_loop_findings(slam.get("loop_decisions") or [], trajectory),
        *_health_findings(slam.get("health") or {}),
        *_odometry_findings(slam.get("odometry") or {}),
        *_source_findings(summary),
    ]
    return sorted(found, key=lambda finding: not finding.grave)


def reason_without_walls(summary: dict[str, Any]) -> str:
    """Return why there is no wall in the map, as a sentence; empty if there are walls."""
    if summary.get("walls") != 0:
        return ""
    health = (summary.get("slam") or {}).get("health") or {}
    scans, empty, few = summary["scans"], health.get("empty_scans", 0), health.get("no_features", 0)
    if 2 * empty > scans:
        return f"no wall was found: {empty} of {scans} scans had no return; is the lidar covered, or all out of range?"
    if 2 * few > scans:
        return f"no wall was found: in {few} of {scans} scans nothing was straight and near; are ranges in metres?"
    seen = "`wclm features` shows the lines of a scan"
    if summary.get("keyframes") == 1:
        return f"no wall was found: the lidar stayed in one place, too briefly to look twice; {seen}"
    return f"no wall was found: no straight line was seen from two places; {seen}"


def searched_at_start(summary: dict[str, Any]) -> float:
    """Return the seconds until the start of a drive was recognised in a map; 0.0 if it was not, or was known."""
    slam = summary.get("slam") or {}
    if not slam.get("start_recognised") or not slam["health"]["lost"]:  # at a given pose, the first scan places it
        return 0.0
    begin, end = slam["lost"][0]
    return float(end - begin)


def health_lines(summary: dict[str, Any]) -> list[str]:
    """Return what the counts and the estimated errors of odometry say against the map, as lines of text."""
    slam = summary.get("slam") or {}
    found = [*_health_findings(slam.get("health") or {}), *_odometry_findings(slam.get("odometry") or {})]
    return [f"{finding.text[:1].lower()}{finding.text[1:].removesuffix('.')}" for finding in found if finding.grave]


def _wall_findings(summary: dict[str, Any]) -> Iterator[Finding]:
    if text := reason_without_walls(summary):
        yield Finding(f"{text[:1].upper()}{text[1:]}", "The path is from odometry and loose points.", grave=True)


def _suspect_findings(rows: list[dict[str, Any]], trajectory: Trajectory) -> Iterator[Finding]:
    """Yield the worst findings of the checks of the finished run, and the number of the others."""
    for row in rows[:MAX_SHOWN_SUSPECTS]:
        yield Finding(
            f"Suspect {_times([row['stamp']], trajectory)}: {row['text']}.",
            SUSPECT_DETAILS.get(row["check"], ""),
            grave=row["check"] != ODOMETRY,
            stamp=float(row["stamp"]),
        )
    if (more := len(rows) - MAX_SHOWN_SUSPECTS) > 0:
        yield Finding(f"{counted(more, 'more suspect')} in summary.json.", "")


def _status_findings(rows: list[dict[str, Any]], trajectory: Trajectory, *, searched: bool) -> Iterator[Finding]:
    """Yield how long and when the localisation status was not OK.

    searched  true if the first time that it was LOST is the search for the place where the drive starts
    """
    ends = [*(row["stamp"] for row in rows), float(trajectory.stamps[-1])][1:]
    for state, (text, detail) in STATUS_FINDINGS.items():
        spans = [(row["stamp"], end) for row, end in zip(rows, ends, strict=True) if row["state"] == state]
        spans = spans[1:] if searched and state == "LOST" else spans
        if spans:
            seconds = sum(end - start for start, end in spans)
            times = _times([start for start, _ in spans], trajectory)
            yield Finding(f"For {seconds:.0f} s in total, {text}, {times}.", detail, state == "LOST", spans[0][0])


def group_warnings(texts: list[str]) -> dict[str, list[float]]:
    """Return the stamps of equal warnings, by their text."""
    stamps: dict[str, list[float]] = {}
    for warning in texts:
        stamped = STAMPED.fullmatch(warning)
        at = stamps.setdefault(stamped["text"] if stamped else warning, [])
        if stamped:
            at.append(float(stamped["stamp"]))
    return stamps


def warning_lines(texts: list[str], start: float) -> list[str]:
    """Return each of equal warnings once, with its first time, and how often it was repeated.

    start  stamp (seconds) from which times are counted
    """
    lines = []
    for text, stamps in group_warnings(texts).items():
        times = f"{counted(len(stamps), 'time')}, first " if len(stamps) > 1 else ""
        lines.append(f"{text} ({times}at {elapsed(stamps[0] - start)})" if stamps else text)
    return lines


def _warning_findings(texts: list[str], trajectory: Trajectory) -> Iterator[Finding]:
    """Yield equal warnings once, with their times."""
    for text, at in group_warnings(texts).items():
        head = text[:1].upper() + text[1:]
        yield Finding(f"{head}." if not at else f"{head}, {_times(at, trajectory)}.", "", stamp=at[0] if at else None)


def _loop_findings(rows: list[dict[str, Any]], trajectory: Trajectory) -> Iterator[Finding]:
    if stamps := [row["stamp"] for row in rows if row["status"] == LoopStatus.RETRACTED]:
        yield Finding(
            f"{counted(len(stamps), 'loop closure')} had to be retracted, {_times(stamps, trajectory)}.",
            "Later scans contradicted it, and the map was estimated again without it. Look-alike places cause this.",
            stamp=stamps[0],
        )


def _health_findings(health: dict[str, Any]) -> Iterator[Finding]:
    overlap_ratio = health.get("overlap_ratio_median")
    if overlap_ratio is not None and overlap_ratio < LOW_OVERLAP_RATIO:
        yield Finding(
            f"Only {percent(overlap_ratio)} of the walls that a scan shows are on walls of the map: the path is wrong, "
            "things move, or the lidar sees the robot itself, the floor or through windows.",
            "lidar.range_min leaves out what is near the lidar, such as parts of the robot.",
            grave=True,
        )
    for name, (text, detail) in COUNT_FINDINGS.items():
        if count := health.get(name, 0):
            yield Finding(f"{counted(count, 'scan')} {text}.", detail)


def _odometry_findings(odometry: dict[str, Any]) -> Iterator[Finding]:
    """Yield findings if odometry deviates much from the scans, or turns around another point than stated."""
    systematic = odometry.get("systematic", {})
    deviation = odometry.get("random", {}).get("along", 0.0)
    if systematic and deviation > HIGH_ODOMETRY_ERROR:  # otherwise predictions deviate, which no wheels have measured
        yield Finding(
            f"Odometry deviates by {percent(deviation)} of the travelled distance.",
            "Slipping wheels, or a wrong wheel size.",
            grave=True,
        )
    for name, noun in (("length", "lengths"), ("turning", "turns")):
        if (estimate := systematic.get(name)) is not None and _is_wrong_scale(estimate):
            yield Finding(
                f"Odometry measures {1.0 / estimate['value']:.2f} times the {noun} that the scans show.",
                "Wrong wheel size, encoder resolution or wheel distance, or skidding. The scans corrected the map.",
                grave=True,
            )
    names = [name for name, limit in MOUNT_ERRORS.items() if _is_beyond(systematic.get(name), limit)]
    if names:
        yield Finding(
            f"The lidar is not where its mount says, relative to the axle: {_mount_error(systematic)}.",
            "Its mount is `lidar.mount`, else that of the recording, else the origin of the base. The map is corrected "
            "for the difference. `wclm calibrate` measures the mount.",
        )


def _is_beyond(estimate: dict[str, float] | None, limit: float) -> bool:
    """Return True if an estimate exceeds a limit, and zero by three standard deviations."""
    return estimate is not None and abs(estimate["value"]) > max(limit, 3.0 * estimate["sigma"])


def _is_wrong_scale(estimate: dict[str, float]) -> bool:
    """Return True if a factor of odometry is beyond MAX_SCALE, or below its inverse, by three standard deviations."""
    low, high = (estimate["value"] + sigmas * estimate["sigma"] for sigmas in (-3.0, 3.0))
    return low > MAX_SCALE or (estimate["value"] > 0.0 and high < 1.0 / MAX_SCALE)


def _mount_error(systematic: dict[str, dict[str, float]]) -> str:
    """Return the pose of odometry's frame in the base's frame with its standard deviations, as text."""
    parts = []
    for name, positive, negative in (("x", "behind", "ahead"), ("y", "to the right", "to the left")):
        value, sigma = 100.0 * systematic[name]["value"], 100.0 * systematic[name]["sigma"]
        parts.append(f"{abs(value):.1f} ± {sigma:.1f} cm {positive if value > 0.0 else negative}")
    value, sigma = (math.degrees(systematic["heading"][key]) for key in ("value", "sigma"))
    parts.append(f"{abs(value):.1f} ± {sigma:.1f} degrees to the {'right' if value > 0.0 else 'left'}")
    return ", ".join(parts)


def _source_findings(summary: dict[str, Any]) -> Iterator[Finding]:
    for doubt in summary.get("doubts") or ():
        yield Finding(f"{doubt[:1].upper()}{doubt[1:]}.", "The recording was read as it is.", grave=True)
    for gap in summary.get("gaps") or ():
        yield Finding(f"The recording has {gap}.", "What the robot did in the meantime is known from the rest only.")
    skipped = summary.get("skipped") or {}
    if count := skipped.get("messages", 0):
        reasons = "; ".join(f"{reason}: {times}" for reason, times in (skipped.get("reasons") or {}).items())
        yield Finding(f"{counted(count, 'message')} of the recording could not be used.", reasons)
    factor = summary.get("real_time_factor")
    if factor is not None and 0.0 < factor < 1.0:
        yield Finding(f"SLAM took {1 / factor:.1f} times as long as the recording.", "Live, it could not have kept up.")


def _times(stamps: list[float], trajectory: Trajectory) -> str:
    """Return the times since the start, equal ones once; if there are many, their number and the first ones."""
    times = list(dict.fromkeys(elapsed(stamp - trajectory.stamps[0]) for stamp in stamps))
    shown = ", ".join(times[:MAX_SHOWN_TIMES])
    if len(stamps) <= MAX_SHOWN_TIMES:
        return f"at {shown}"
    return f"{len(stamps)} times, {'first ' if len(times) > MAX_SHOWN_TIMES else ''}at {shown}"
