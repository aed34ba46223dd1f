"""The entries of `summary.json` that every run has, whatever made it: docs/results.md#summaryjson."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from drivers.messages import SourceReport

from ..events import Finished
from ..io.host import peak_memory, versions


class RunTimes(NamedTuple):
    """Seconds that the estimate of a run took, and that the run took with reading its input."""

    slam: float
    wall: float


def summarise(
    finished: Finished,
    *,
    recording: str,
    recording_path: str | None,
    scans: int,
    odometry: int,
    duration: float,
    path_length: float,
    times: RunTimes | None = None,
    report: SourceReport | None = None,
    warnings: Sequence[str] = (),
    truth: dict[str, float] | None = None,
    seed: int | None = None,
) -> dict[str, Any]:
    """Return the summary of a run.

    recording       name
    recording_path  argument that opens it again; None if that is not possible
    scans, odometry numbers of messages
    duration        seconds of measurements
    path_length     metres driven
    times           None if they were not measured
    report          of the source of the measurements; None if it has none
    warnings        texts for the user
    truth           errors against ground truth
    seed            of a simulation
    """
    report = report or SourceReport()
    measured = (
        {}
        if times is None
        else {
            "slam_seconds": times.slam,
            "wall_seconds": times.wall,
            "real_time_factor": duration / times.slam,
            "peak_memory_mib": peak_memory(),
        }
    )
    return {
        "recording": recording,
        "recording_path": recording_path,
        "seed": seed,
        "scans": scans,
        "odometry": odometry,
        "start": float(finished.stamps[0]),
        "duration": duration,
        "keyframes": len(finished.keyframes),
        "walls": len(finished.walls),
        "corners": len(finished.corners),
        "path_length": path_length,
        **measured,
        "truth": truth,
        "warnings": warnings,
        "skipped": {"messages": report.skipped, "reasons": report.reasons, "first": report.first},
        "corrected": report.corrected,
        "interpretations": report.interpretations,
        "doubts": report.doubts,
        "slam": finished.summary,
        "versions": versions(),
    }


def summary_of_changed_map(before: dict[str, Any]) -> dict[str, Any]:
    """Return the summary of a run whose map was changed later, without what holds for the map of the run only.

    These are the errors against ground truth, the comparison with a plan, and that the run went on when it was saved.
    """
    kept = {name: value for name, value in before.items() if name not in ("plan", "unfinished")}
    return kept | {"truth": None, "versions": versions()}
