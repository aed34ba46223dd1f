"""The page's parts below the map, each a piece of HTML; an empty one where a session has nothing to tell."""

from __future__ import annotations

from html import escape
from typing import Any

from .findings import Finding
from .words import clock, counted, duration, length, percent

STATUS = {"accepted": "closed", "retracted": "taken back", "held": "waited", "rejected": "refused"}
SHOWN = ("accepted", "retracted")
"""Decisions that changed the map; the others are folded away."""
TERMS = {
    "what": "one that waited had passed, but needed a second look that agreed, and none came",
    "keyframes": "where it was decided, and one that saw the place before",
    "overlap_ratio": "of the wall seen lately, the share that would fall on old walls; the more the better",
    "walls": "how many walls would",
    "runner-up": "how much another place explains, relative to this one: near 100 % the two cannot be told apart",
    "σ": "how well the motion is known where it is known worst",
    "contradicted": "share of the wall seen lately that old walls would have hidden; the less the better",
    "moved by": "how far the robot's place was corrected",
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
    """The run in a few numbers."""
    told = [
        ("driven", length(summary["path_length"])),
        ("in", duration(summary["duration"])),
        ("walls", str(summary["walls"])),
        ("corners", str(summary["corners"])),
        ("keyframes", str(summary["keyframes"])),
        ("scans", str(summary["scans"])),
    ]
    return "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in told)


def wrong(found: list[Finding]) -> str:
    """What looked wrong, or that nothing did."""
    if not found:
        return '<p class="good">Nothing looked wrong.</p>'
    return f"<ul>{''.join(map(_item, found))}</ul>"


def _item(finding: Finding) -> str:
    weight = "grave" if finding.grave else "minor"
    return f'<li class="{weight}"><b>{escape(finding.text)}</b> {escape(finding.detail)}</li>'


def loops(slam: dict[str, Any], start: float) -> str:
    """How many places looked known and what became of them; each decision where the summary has them."""
    counts = slam.get("loops") or {}
    if not counts.get("proposed"):
        return "<p>No place looked like one seen before.</p>"
    told = ", ".join(f"{counts.get(name, 0)} {word}" for name, word in STATUS.items() if counts.get(name, 0))
    head = f"<p>{counted(counts['proposed'], 'time')} a place looked known: {told}.</p>"
    rows = slam.get("loop_decisions") or []
    shown = [row for row in rows if row["status"] in SHOWN]
    folded = [row for row in rows if row["status"] not in SHOWN]
    body = _decisions(shown, start) if shown else ""
    if folded:
        title = f"{len(folded)} that were not closed, and why"
        body += f"<details><summary>{title}</summary>{_decisions(folded, start)}</details>"
    return head + body + (_terms() if rows else "")


def _terms() -> str:
    told = "".join(f"<dt>{name}</dt><dd>{meaning}</dd>" for name, meaning in TERMS.items())
    return f'<details><summary>What the columns mean</summary><dl class="terms">{told}</dl></details>'


def _decisions(rows: list[dict[str, Any]], start: float) -> str:
    columns = (
        ("at", lambda row: clock(row["stamp"] - start)),
        ("what", lambda row: STATUS.get(row["status"], row["status"])),
        ("keyframes", lambda row: f"{row['keyframe']} → {row['old']}"),
        ("why", lambda row: row["reason"] or "–"),
        ("overlap_ratio", lambda row: percent(row["overlap_ratio"])),
        ("walls", lambda row: str(row["matches"])),
        ("runner-up", lambda row: percent(row["runner_up"])),
        ("σ", lambda row: length(row["sigma"])),
        ("contradicted", lambda row: percent(row["contradicted"])),
        ("moved by", lambda row: length(row["shift"]) if row["shift"] else "–"),
    )
    lines = []
    for row in rows:
        cells = "".join(f'<td data-label="{name}">{escape(_told(tell, row))}</td>' for name, tell in columns)
        lines.append(f'<tr class="{escape(str(row["status"]))}" data-loop="{row["candidate"]}">{cells}</tr>')
    heads = "".join(f"<th>{name}</th>" for name, _ in columns)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _told(tell: Any, row: dict[str, Any]) -> str:
    """A cell; a value that was not finite is null in the summary."""
    try:
        return str(tell(row))
    except TypeError:
        return "–"


def accuracy(truth: dict[str, Any] | None) -> str:
    """How far the path is from the true one, where the recording knows it."""
    if not truth:
        return "<p>The recording does not know the true path.</p>"
    rows = "".join(
        f"<tr><td>{name}</td><td>{length(truth[key]) if unit == 'm' else f'{truth[key]:.2f}°'}</td></tr>"
        for key, name, unit in ACCURACY
        if truth.get(key) is not None
    )
    return f'<table class="plain"><tbody>{rows}</tbody></table>'


def timings(summary: dict[str, Any]) -> str:
    """How long it took, and where the time of a keyframe goes."""
    slam_timings = (summary.get("slam") or {}).get("timings") or {}
    factor = summary["real_time_factor"]
    head = (
        f"<p>{duration(summary['slam_seconds'])} for SLAM, {factor:.3g} times as fast as the drive, and at most "
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
    caption = "<caption>of a keyframe, mean of each stage</caption>"
    return f'{head}</p><table class="plain">{caption}<tbody>{bars}</tbody></table>' if bars else f"{head}</p>"


def details(summary: dict[str, Any], settings: str) -> str:
    """What it was made with: seed, noise that was learned, versions, settings."""
    slam = summary.get("slam") or {}
    learned = (
        ("recording", summary.get("recording_path") or summary.get("recording")),
        ("seed of the simulation", summary.get("seed")),
        ("factors in the graph", slam.get("factors")),
        ("noise of a range, learned, metres", slam.get("sigma_range")),
        ("unevenness of the walls, learned, metres", slam.get("wall_unevenness")),
        ("odometry's error per metre, learned: metres, radians", slam.get("odometry_deviation_per_metre")),
        *(summary.get("versions") or {}).items(),
    )
    rows = "".join(
        f"<tr><td>{escape(str(name))}</td><td>{escape(str(value))}</td></tr>"
        for name, value in learned
        if value is not None
    )
    return f'<table class="plain"><tbody>{rows}</tbody></table><pre>{escape(settings)}</pre>'
