"""Write the sections below the map as HTML."""

from __future__ import annotations

from html import escape
from typing import Any

from ...loop_closure.loop_status import LoopStatus
from .findings import Finding
from .formatting import clock, counted, duration, length, percent

APPLIED = (LoopStatus.ACCEPTED, LoopStatus.RETRACTED)
"""Decisions that changed the map; the others are in a collapsed table."""
COLUMN_MEANINGS = {
    "keyframes": "keyframe of the decision, and one that observed the place before",
    "overlap": "share of the recent points that fit the old place, of those in space seen before; higher is better",
    "looks": "number of looks at old places that agree with the closure",
    "alternative": "looks that support the strongest rival, as a share; near 100 % the two are indistinguishable",
    "σ": "standard deviation of the motion in its least certain direction",
    "contradicted": "share of the looks that contradict the closure; lower is better",
    "moved by": "correction of the robot's position",
}
ACCURACY = (
    ("ate_rmse", "position, RMS", "m"),
    ("ate_median", "position, median", "m"),
    ("ate_max", "position, largest", "m"),
    ("heading_rmse", "heading, RMS", "degrees"),
    ("rpe_trans_rmse", "drift of position, RMS", "m"),
    ("rpe_rot_rmse", "drift of heading, RMS", "degrees"),
)


def facts(summary: dict[str, Any]) -> str:
    """Return the run in a few numbers."""
    entries = [
        ("driven", length(summary["path_length"])),
        ("duration", duration(summary["duration"])),
        ("walls", str(summary["walls"])),
        ("corners", str(summary["corners"])),
        ("keyframes", str(summary["keyframes"])),
        ("scans", str(summary["scans"])),
    ]
    return "".join(f"<div><dt>{name}</dt><dd>{escape(value)}</dd></div>" for name, value in entries)


def findings_list(findings: list[Finding]) -> str:
    """Return the findings, or the statement that there are none."""
    if not findings:
        return '<p class="good">No problems found.</p>'
    return f"<ul>{''.join(map(_item, findings))}</ul>"


def _item(finding: Finding) -> str:
    weight = "grave" if finding.grave else "minor"
    return f'<li class="{weight}"><b>{escape(finding.text)}</b> {escape(finding.detail)}</li>'


def loops(slam: dict[str, Any], start: float) -> str:
    """Return the number of loop candidates by status, and each decision if the summary contains them."""
    counts = slam.get("loops") or {}
    if not counts.get("proposed"):
        return "<p>There were no loop candidates.</p>"
    by_status = ", ".join(f"{counts[status]} {status}" for status in LoopStatus if counts.get(status, 0))
    head = f"<p>{escape(counted(counts['proposed'], 'loop candidate'))}: {escape(by_status)}.</p>"
    rows = slam.get("loop_decisions") or []
    applied = [row for row in rows if row["status"] in APPLIED]
    others = [row for row in rows if row["status"] not in APPLIED]
    body = _decisions(applied, start) if applied else ""
    if others:
        title = f"{len(others)} not accepted, with reasons"
        body += f"<details><summary>{title}</summary>{_decisions(others, start)}</details>"
    return head + body + (_column_meanings() if rows else "")


def _column_meanings() -> str:
    entries = "".join(f"<dt>{name}</dt><dd>{meaning}</dd>" for name, meaning in COLUMN_MEANINGS.items())
    return f'<details><summary>Meaning of the columns</summary><dl class="terms">{entries}</dl></details>'


def _decisions(rows: list[dict[str, Any]], start: float) -> str:
    columns = (
        ("time", lambda row: clock(row["stamp"] - start)),
        ("status", lambda row: row["status"]),
        ("keyframes", lambda row: f"{row['keyframe']} → {row['old']}"),
        ("reason", lambda row: row["reason"] or "–"),
        ("overlap", lambda row: percent(row["overlap_ratio"])),
        ("looks", lambda row: str(row["matches"])),
        ("alternative", lambda row: percent(row["runner_up"])),
        ("σ", lambda row: length(row["sigma"])),
        ("contradicted", lambda row: percent(row["contradicted"])),
        ("moved by", lambda row: length(row["shift"]) if row["shift"] else "–"),
    )
    lines = []
    for row in rows:
        cells = "".join(f'<td data-label="{name}">{escape(_cell(value_of, row))}</td>' for name, value_of in columns)
        lines.append(
            f'<tr class="{escape(str(row["status"]))}" data-loop="{escape(str(row["candidate"]))}">{cells}</tr>'
        )
    heads = "".join(f"<th>{name}</th>" for name, _ in columns)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _cell(value_of: Any, row: dict[str, Any]) -> str:
    """Return a table cell; values that are not finite are null in the summary."""
    try:
        return str(value_of(row))
    except TypeError:
        return "–"


def accuracy(truth: dict[str, Any] | None) -> str:
    """Return the errors of the path against ground truth if there is any."""
    if not truth:
        return "<p>The recording contains no ground truth.</p>"
    rows = "".join(
        f"<tr><td>{name}</td><td>{length(truth[key]) if unit == 'm' else f'{truth[key]:.2f}°'}</td></tr>"
        for key, name, unit in ACCURACY
        if truth.get(key) is not None
    )
    return f'<table class="plain"><tbody>{rows}</tbody></table>'


def timings(summary: dict[str, Any]) -> str:
    """Return run time and memory, and the mean time of each stage of a keyframe."""
    slam_timings = (summary.get("slam") or {}).get("timings") or {}
    factor = summary["real_time_factor"]
    head = (
        f"<p>{duration(summary['slam_seconds'])} for SLAM, {factor:.3g} times as fast as the recording, with at most "
        f"{summary['peak_memory_mib']:.0f} MiB of memory."
    )
    if "keyframe_median_ms" in slam_timings:
        median, most, longest = (slam_timings[f"keyframe_{name}_ms"] for name in ("median", "p99", "max"))
        head += f" A keyframe took {median:.1f} ms (median), {most:.1f} ms (99 % of them), {longest:.0f} ms at most."
    stages = {
        name.removesuffix("_mean_ms").replace("_", " "): value
        for name, value in slam_timings.items()
        if name.endswith("_mean_ms")
    }
    slowest = max(stages.values(), default=0.0) or 1.0
    bars = "".join(
        f'<tr><td>{escape(name)}</td><td class="bar"><i style="width:{100 * value / slowest:.1f}%"></i></td>'
        f"<td>{value:.2f} ms</td></tr>"
        for name, value in stages.items()
    )
    caption = "<caption>mean time of each stage of a keyframe</caption>"
    return f'{head}</p><table class="plain">{caption}<tbody>{bars}</tbody></table>' if bars else f"{head}</p>"


def details(summary: dict[str, Any], settings: str) -> str:
    """Return recording, seed, estimated parameters, versions and settings."""
    slam = summary.get("slam") or {}
    entries = (
        ("recording", summary.get("recording_path") or summary.get("recording")),
        ("seed of the simulation", summary.get("seed")),
        ("factors in the graph", slam.get("factors")),
        ("estimated range noise, metres", slam.get("sigma_range")),
        ("estimated range bias and its standard deviation, metres", _range_bias(slam.get("range_bias"))),
        ("estimated wall roughness, metres", slam.get("wall_roughness")),
        ("estimated odometry error per metre: metres, radians", slam.get("odometry_deviation_per_metre")),
        *(summary.get("versions") or {}).items(),
    )
    rows = "".join(
        f"<tr><td>{escape(str(name))}</td><td>{escape(str(value))}</td></tr>"
        for name, value in entries
        if value is not None
    )
    return f'<table class="plain"><tbody>{rows}</tbody></table><pre>{escape(settings)}</pre>'


def _range_bias(bias: dict[str, float | None] | None) -> str | None:
    return None if not bias or bias["sigma"] is None else f"{bias['metres']} ± {bias['sigma']}"
