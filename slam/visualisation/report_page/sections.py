"""Write the sections below the map as HTML."""

from __future__ import annotations

from html import escape
from typing import Any

from drivers.elapsed import elapsed

from ...formatting import duration, length, percent
from ...geometry.segments import Floats
from ...io.tum import Trajectory
from ...loop_closure.loop_status import LoopStatus
from .correction_text import outcome_lines
from .findings import Finding
from .loop_text import by_margin, loops_text, no_loops_text, returns_text

APPLIED = (LoopStatus.ACCEPTED, LoopStatus.RETRACTED, LoopStatus.FORBIDDEN)
"""Decisions that changed the map; the others are in a table of their own."""
BY_HAND = (
    "If you know better: choose a loop in the table, then state below the map whether it is right or wrong. "
    "<code>wclm correct</code> forbids a closed loop, and closes another one."
)
COLUMN_MEANINGS = {
    "loop": "number N of the loop",
    "keyframes": "keyframe of the decision, and one that observed the place before",
    "overlap": "share of the recent points that fit the old place, of those in space seen before; higher is better",
    "looks": "number of looks at old places that agree with the closure",
    "rival": "looks that support the strongest rival, as a share; near 100 % the two are indistinguishable",
    "σ": "standard deviation of the motion in its least certain direction",
    "contradicted": "share of the looks that contradict the closure; lower is better",
    "moved by": "correction of the robot's position",
    "met": "share of its requirement that the worst check meets; 100 % would have closed the loop",
}
MAX_SHOWN = 4
"""Items of a list with pictures that are shown at once."""
PICTURE_SIZE = 12.0
"""Metres shown around the place of a finding."""
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


def successes(summary: dict[str, Any], found: list[Finding]) -> str:
    """Return the section on what went well; empty if nothing did."""
    slam = summary.get("slam") or {}
    health, truth = slam.get("health") or {}, summary.get("truth") or {}
    texts = [returns_text(slam)]
    if closed := (slam.get("loops") or {}).get(LoopStatus.ACCEPTED, 0):
        texts.append(loops_text({**slam, "loops": {LoopStatus.ACCEPTED: closed}}))
    spoilt = any(finding.grave for finding in found)
    if "lost" in health and not health["lost"] and not health.get("failed") and not spoilt:
        scans = "every scan that showed features" if health.get("no_features") else "every scan"
        texts.append(f"{scans} was placed in the map; the robot was never lost")
    if health.get("overlap_ratio_median") is not None and not spoilt:
        texts.append(
            f"{percent(health['overlap_ratio_median'])} of the walls in a scan are on walls of the map (median)"
        )
    if truth.get("ate_rmse") is not None:
        texts.append(f"the path is within {length(truth['ate_rmse'])} of the true one (RMS)")
    items = "".join(f"<li>{escape(text[:1].upper() + text[1:])}.</li>" for text in texts if text)
    return f'<section id="successes"><h2>What went well</h2><ul>{items}</ul></section>' if items else ""


def findings_list(findings: list[Finding], trajectory: Trajectory, extent: float) -> str:
    """Return the findings, or the statement that there are none.

    extent  larger side of the drawing, metres
    """
    if not findings:
        return '<p class="good">No problems found.</p>'
    return item_list([_item(finding, trajectory, extent) for finding in findings])


def item_list(items: list[str]) -> str:
    """Return a list of which the first items are shown, and the others after a click."""
    shown, more = "".join(items[:MAX_SHOWN]), items[MAX_SHOWN:]
    rest = f"<details><summary>{len(more)} more</summary><ul>{''.join(more)}</ul></details>" if more else ""
    return f"<ul>{shown}</ul>{rest}"


def _item(finding: Finding, trajectory: Trajectory, extent: float) -> str:
    weight = "grave" if finding.grave else "minor"
    picture = ""
    if finding.stamp is not None:
        position = trajectory.poses[int(trajectory.nearest([finding.stamp])[0]), :2]
        picture = place_button(position, finding.stamp - trajectory.stamps[0], extent)
    return f'<li class="{weight}">{picture}<span><b>{escape(finding.text)}</b> {escape(finding.detail)}</span></li>'


def place_button(position: Floats, time: float, extent: float) -> str:
    """Return a button with the part of the map around a place, which shows it on the map.

    position  (2,) in the map, metres
    time      seconds since the start at which the robot was there
    extent    larger side of the drawing, metres
    """
    x, y = position
    half = min(PICTURE_SIZE, extent) / 2
    return (
        f'<button type="button" class="place" data-time="{time:.1f}" data-x="{x:.2f}" data-y="{-y:.2f}" '
        f'aria-label="Show on the map"><svg viewBox="{x - half:.2f} {-y - half:.2f} {2 * half:.2f} {2 * half:.2f}" '
        f'aria-hidden="true"><use href="#drawing"/><circle class="here" cx="{x:.2f}" cy="{-y:.2f}" r="{half / 6:.2f}"/>'
        "</svg></button>"
    )


def loops(slam: dict[str, Any], start: float) -> str:
    """Return what became of the loops, and each decision: applied ones by time, rejected ones by their margins."""
    rows = slam.get("loop_decisions") or []
    text = loops_text(slam)
    if not text:
        return f"<p>{escape(no_loops_text(slam))}</p>"
    applied = [row for row in rows if row["status"] in APPLIED]
    others = by_margin([row for row in rows if row["status"] not in APPLIED])
    body = f"<p>{escape(text[:1].upper() + text[1:])}.</p>" + (_decisions(applied, start) if applied else "")
    if others:
        note = (
            "Places that looked known. Closing these loops would not have been safe; the nearest to being closed first."
        )
        body += f"<h3>Rejected as unsafe</h3><p>{note}</p>{_decisions(others, start)}"
    return body + (f"<p>{BY_HAND}</p>{_column_meanings()}" if rows else "")


def _column_meanings() -> str:
    entries = "".join(f"<dt>{name}</dt><dd>{meaning}</dd>" for name, meaning in COLUMN_MEANINGS.items())
    return f'<details><summary>Meaning of the columns</summary><dl class="terms">{entries}</dl></details>'


def _decisions(rows: list[dict[str, Any]], start: float) -> str:
    columns = (
        ("loop", lambda row: str(row["candidate"])),
        ("time", lambda row: elapsed(row["stamp"] - start)),
        ("status", lambda row: row["status"]),
        ("keyframes", lambda row: f"{row['keyframe']} → {row['old']}"),
        ("reason", lambda row: row["reason"] or "–"),
        ("overlap", lambda row: percent(row["overlap_ratio"])),
        ("looks", lambda row: str(row["matches"])),
        ("rival", lambda row: percent(row["runner_up"])),
        ("σ", lambda row: length(row["sigma"])),
        ("contradicted", lambda row: percent(row["contradicted"])),
        ("moved by", lambda row: length(row["shift"]) if row["shift"] else "–"),
        ("met", lambda row: percent(row["margin"]) if row.get("margin") is not None else "–"),
    )
    lines = []
    for row in rows:
        cells = "".join(f'<td data-label="{name}">{escape(_cell(value_of, row))}</td>' for name, value_of in columns)
        lines.append(
            f'<tr class="{escape(str(row["status"]))}" data-loop="{escape(str(row["candidate"]))}" tabindex="0">'
            f"{cells}</tr>"
        )
    heads = "".join(f"<th>{name}</th>" for name, _ in columns)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _cell(value_of: Any, row: dict[str, Any]) -> str:
    """Return a table cell; values that are not finite are null in the summary."""
    try:
        return str(value_of(row))
    except TypeError:
        return "–"


def corrections(outcomes: list[dict[str, Any]]) -> str:
    """Return a section with the manual corrections and what became of them; empty if there are none."""
    if not outcomes:
        return ""
    items = []
    for outcome in outcomes:
        lines = "".join(f"<li>{escape(line)}</li>" for line in outcome_lines(outcome))
        items.append(f"<li>{escape(str(outcome['text']))}{f'<ul>{lines}</ul>' if lines else ''}</li>")
    note = (
        "The graph was solved again with these decisions of a person. The last one can be undone: wclm correct --undo."
    )
    return f'<section id="corrections"><h2>Manual corrections</h2><p>{note}</p><ol>{"".join(items)}</ol></section>'


def accuracy(truth: dict[str, Any] | None) -> str:
    """Return a section with the errors of the path against ground truth; empty if there is none."""
    if not truth:
        return ""
    rows = "".join(
        f"<tr><td>{name}</td><td>{length(truth[key]) if unit == 'm' else f'{truth[key]:.2f}°'}</td></tr>"
        for key, name, unit in ACCURACY
        if truth.get(key) is not None
    )
    table = f'<table class="plain"><tbody>{rows}</tbody></table>'
    return f'<section id="accuracy"><h2>Errors against ground truth</h2>{table}</section>'


def timings(summary: dict[str, Any]) -> str:
    """Return run time and memory, if they were measured, and the mean time of each stage of a keyframe."""
    slam_timings = (summary.get("slam") or {}).get("timings") or {}
    head = "<p>"
    if "slam_seconds" in summary:
        head += (
            f"{duration(summary['slam_seconds'])} for SLAM, {summary['real_time_factor']:.3g} times as fast as the "
            f"recording, with at most {summary['peak_memory_mib']:.0f} MiB of memory."
        )
    if "keyframe_median_ms" in slam_timings:
        median, most, longest = (slam_timings[f"keyframe_{name}_ms"] for name in ("median", "p99", "max"))
        most_of_them = f"{most:.1f} ms (99\N{NO-BREAK SPACE}% of them)"
        head += f" A keyframe took {median:.1f} ms (median), {most_of_them}, {longest:.0f} ms at most."
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
    """Return recording, how it was read, seed, estimated parameters, versions and settings."""
    slam = summary.get("slam") or {}
    entries = (
        ("recording", _path_text(summary.get("recording_path")) or summary.get("recording")),
        ("read as", "; ".join(map(str, summary.get("interpretations") or ())) or None),
        ("seed of the simulation", summary.get("seed")),
        ("factors in the graph", slam.get("factors")),
        ("estimated range noise, metres", slam.get("sigma_range")),
        ("estimated bearing noise, radians", slam.get("sigma_bearing")),
        ("estimated range bias and its standard deviation, metres", _range_bias(slam.get("range_bias"))),
        ("estimated wall roughness, metres", slam.get("wall_roughness")),
        ("estimated bends of walls, metres", (slam.get("wall_bends") or {}).get("sigma")),
        ("estimated systematic errors of odometry", _systematic_errors(slam.get("odometry") or {})),
        ("estimated random errors of odometry", _random_errors(slam.get("odometry") or {})),
        ("estimated bias of the gyroscope", _gyroscope_bias(slam.get("gyroscope"))),
        *(summary.get("versions") or {}).items(),
    )
    rows = "".join(
        f"<tr><td>{escape(str(name))}</td><td>{escape(str(value))}</td></tr>"
        for name, value in entries
        if value is not None
    )
    return f'<table class="plain"><tbody>{rows}</tbody></table><pre>{escape(settings)}</pre>'


def _path_text(path: str | None) -> str | None:
    """Return the path of a file, which need not be UTF-8, as text."""
    return None if path is None else path.encode(errors="replace").decode()


def _systematic_errors(odometry: dict[str, Any]) -> str | None:
    """Return the systematic errors of odometry with their standard deviations; None if they were not estimated."""
    errors = odometry.get("systematic")
    if not errors:
        return None
    units = {"veer": " rad/m", "x": " m", "y": " m", "heading": " rad"}  # the others are factors
    return ", ".join(f"{name} {e['value']:g} ± {e['sigma']:g}{units.get(name, '')}" for name, e in errors.items())


def _random_errors(odometry: dict[str, Any]) -> str | None:
    """Return the standard deviations of odometry's random errors; None if they were not estimated."""
    errors = odometry.get("random")
    if not errors:
        return None
    return (
        f"position {errors['along']:g} m/m along and {errors['across']:g} m/m across the motion, heading "
        f"{errors['heading_per_metre']:g} rad after one metre and {errors['heading_per_radian']:g} rad after one radian"
    )


def _gyroscope_bias(bias: dict[str, float] | None) -> str | None:
    return None if not bias else f"{bias['bias']:g} ± {bias['sigma']:g} rad/s"


def _range_bias(bias: dict[str, float | None] | None) -> str | None:
    return None if not bias or bias["sigma"] is None else f"{bias['metres']} ± {bias['sigma']}"
