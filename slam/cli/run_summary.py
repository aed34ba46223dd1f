"""Summary of a run: as data for summary.json, and as lines of text for the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.elapsed import elapsed
from drivers.immutable import immutable

from ..formatting import counted, duration, percent
from ..io.output_dir import TRAJECTORY
from ..io.run_results import refusing_damaged_summary
from ..reporting.log_text import log_losses_text
from ..reporting.summary import RunTimes, summarise
from .console import printable

if TYPE_CHECKING:
    from ..evaluation.metrics import ReferenceScore
    from ..events import Finished
    from ..io.run_results import RunResults
    from ..reporting.input_statistics import InputStatistics
    from .run_input import RunInput

SHOWN_WARNINGS = 4
SHOWN_SUSPECTS = 5
SHOWN_SPANS = 4
SHOWN_DIFFERENCES = 8


@immutable
class RunResult:
    """Result of a run: the content of summary.json, and True in `review` if there is a review log."""

    summary: dict[str, Any]
    review: bool


def summarise_run(
    run_input: RunInput,
    finished: Finished,
    statistics: InputStatistics,
    notices: list[str],
    score: ReferenceScore | None,
    *,
    seed: int | None,
    times: RunTimes,
) -> dict[str, Any]:
    """Return the summary of a run: its input, result, times, memory and warnings.

    score  error against ground truth, if known
    times  of the pipeline, and from the first message to the end
    """
    return (
        summarise(
            finished,
            recording=run_input.name,
            recording_path=run_input.reopen,
            scans=statistics.scans,
            odometry=statistics.odometry,
            duration=statistics.duration,
            path_length=path_length(finished, statistics.first, statistics.last),
            times=times,
            report=run_input.report,
            warnings=notices,
            truth=None if score is None else score.figures(),
            seed=seed,
        )
        | run_input.facts()
    )


def path_length(finished: Finished, first: float, last: float) -> float:
    """Return the metres driven between two stamps (seconds): those of one recording of a session."""
    from ..io.tum import Trajectory

    own = (finished.stamps >= first) & (finished.stamps <= last)
    return Trajectory(finished.stamps[own], finished.poses[own]).length if own.any() else 0.0


def check_summary(results: RunResults) -> None:
    """Raise MapError if the summary of a run is damaged, so that it cannot be shown as text or on a page."""
    from ..visualisation.report_page import check_page

    check_page(results)
    with refusing_damaged_summary(results.path):
        format_summary(RunResult(results.summary, review=False), results.path)


def format_summary(result: RunResult, out: Path) -> list[str]:
    """Return the summary as lines of text; `out` is the output directory."""
    from ..visualisation.report_page.findings import health_lines, reason_without_walls, warning_lines

    summary = result.summary
    walls, corners, keyframes = (counted(summary[f"{noun}s"], noun) for noun in ("wall", "corner", "keyframe"))
    rows = [
        ("map", f"{walls}, {corners}, from {keyframes}"),
        ("time", _time(summary)),
    ]
    if truth := summary.get("truth"):
        rows.append(
            ("accuracy", f"{truth['ate_rmse']:.3f} m error of the path (ATE RMSE), at most {truth['ate_max']:.3f} m")
        )
    rows += _loops(summary) + _lost(summary) + _plan(summary)
    skipped = summary.get("skipped") or {}
    if count := skipped.get("messages", 0):
        rows.append(("skipped", f"{counted(count, 'message')}; first: {skipped.get('first')}"))
    recordings = summary.get("recordings") or [{}]
    if shift := recordings[-1].get("shift"):
        where = "" if len(recordings) > 1 else f"in {TRAJECTORY} as recorded; in the other files "
        moved = f"{abs(shift):.0f} s {'later' if shift > 0 else 'earlier'}"
        rows.append(("stamps", f"{where}{moved} than recorded, to follow those of the session"))
    rows += [("read as", text) for text in summary.get("interpretations") or ()]
    rows += [("device", _device(device)) for device in summary.get("devices", ())]
    if losses := log_losses_text(summary.get("review") or {}):
        rows.append(("log", losses))
    rows += [("warning", text) for text in [*(summary.get("gaps") or ()), *(summary.get("doubts") or ())]]
    rows += [("warning", text) for text in (reason_without_walls(summary), *health_lines(summary)) if text]
    warnings = warning_lines(summary.get("warnings") or [], summary["start"])
    rows += [("warning", line) for line in warnings[:SHOWN_WARNINGS]]
    if (more := len(warnings) - SHOWN_WARNINGS) > 0:
        rows.append(("", f"and {more} more warnings in summary.json"))
    rows.append(("results", f"{out}: {', '.join(sorted(entry.name for entry in out.iterdir()))}"))
    if result.review:
        rows.append(("view with", f"wclm review {out}"))
    head = (
        f"{summary['recording']}: {counted(summary['scans'], 'scan')} in {summary['duration']:.1f} s, "
        f"{summary['path_length']:.1f} m driven"
    )
    return [printable(line) for line in [head, *(f"  {name:<11}{text}" for name, text in rows), *_suspects(summary)]]


def _plan(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return how the map agrees with the plan, and the differences."""
    plan = summary.get("plan")
    if plan is None or not plan["recognised"]:
        return []  # a warning states it
    differences = plan["differences"]
    number = counted(len(differences), "difference")
    rows = [("plan", f"{plan['same']} walls are as in {plan['file']}, {number}")]
    rows += [("", line) for line in differences[:SHOWN_DIFFERENCES]]
    if (more := len(differences) - SHOWN_DIFFERENCES) > 0:
        rows.append(("", f"and {more} more differences in summary.json"))
    return rows


def _loops(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return how often the robot returned to known places, and which loops were closed or rejected."""
    from ..visualisation.report_page.loop_text import loops_text, nearest_rejection, returns_text

    slam = summary.get("slam") or {}
    nearest = nearest_rejection(slam, summary["start"])
    rows = [
        ("returns", returns_text(slam)),
        ("loops", loops_text(slam)),
        ("", nearest and f"the nearest one {nearest}"),
    ]
    return [(name, text) for name, text in rows if text]


def _lost(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Return when the robot was lost and for how long, and which parts of the map were joined."""
    from ..visualisation.report_page.findings import searched_at_start

    slam, start = summary.get("slam") or {}, summary["start"]
    spans = slam.get("lost") or []
    rows = []
    if searched := searched_at_start(summary):
        rows.append(("start", f"recognised in the map after {duration(searched)}"))
        spans = spans[1:]
    if spans and slam["health"]["lost"]:  # at a given pose, the first scan places the robot
        times = ", ".join(
            f"at {elapsed(begin - start)} for {duration(end - begin)}" for begin, end in spans[:SHOWN_SPANS]
        )
        more = f", and {len(spans) - SHOWN_SPANS} more times" if len(spans) > SHOWN_SPANS else ""
        share = slam["health"]["lost"] / max(1, slam["scans"])
        rows.append(("LOST", f"{times}{more}; {percent(share, 1)} of the scans"))
    parts = slam.get("parts") or []
    later = [row for row in parts[1:] if row["stamp"] >= start]  # a run that only localises has made none
    if later:
        joined = [
            f"{elapsed(row['stamp'] - start)} {'joined' if row['joined'] else 'not joined'}"
            for row in later[:SHOWN_SPANS]
        ]
        more = ", …" if len(later) > SHOWN_SPANS else ""
        rows.append(("parts", f"{len(parts)} in the map; those from {', '.join(joined)}{more}"))
    return rows


def _suspects(summary: dict[str, Any]) -> list[str]:
    """Return a line for each of the worst suspects."""
    rows = (summary.get("slam") or {}).get("suspects") or []
    lines = [f"  SUSPECT {row['sentence']}" for row in rows[:SHOWN_SUSPECTS]]
    if (more := len(rows) - SHOWN_SUSPECTS) > 0:
        lines.append(f"  and {counted(more, 'more suspect')} in summary.json")
    return lines


def _device(device: dict[str, Any]) -> str:
    """Return the message count and the faults of a device."""
    from .device_monitor import format_faults

    counters = device["counters"]
    return ", ".join([f"{device['spec']}: {counters['messages']} messages", *format_faults(counters)])


def _time(summary: dict[str, Any]) -> str:
    if "slam_seconds" not in summary:  # the run of a program in Python
        return "not measured"
    factor = summary["real_time_factor"]
    speed = f"{factor:.0f} times faster than real time" if factor >= 2 else f"{factor:.2f} times as fast as real time"
    return (
        f"{summary['slam_seconds']:.1f} s for SLAM, {speed}; {summary['wall_seconds']:.1f} s with reading and writing, "
        f"{summary['peak_memory_mib']:.0f} MiB"
    )
