"""Count and time what happens during a run, and summarise it as plain data for `summary.json`."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..estimation.scan_update import KeyframeUpdate
from ..estimation.slam_state import SlamState
from ..estimation.stage_timer import StageTimer
from ..geometry.surroundings import MIN_WALL_LENGTH
from ..graph.range_bias import RangeBias
from ..localisation.state import LocalisationState, LocalisationStatus
from ..localisation.tracking import TrackingResult, TrackingStatus
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..loop_closure.returns import summarise
from ..mapping.mapper import Mapper
from ..odometry.error_model import OdometryModel
from ..preprocessing.preprocessor import Preprocessor, ProcessedScan

DECIDED = (LoopStatus.REJECTED, LoopStatus.ACCEPTED, LoopStatus.RETRACTED)
"""Statuses of loops that a run counts."""


@dataclass(slots=True)
class RunStatistics:
    """Counts and times of a run.

    slipped_scans      scans from which odometry was far off
    failed_scans       scans that fitted nowhere near their predicted poses
    featureless_scans  scans with too little wall and too few points
    lost_scans         scans taken while the robot was LOST
    states             stamp (seconds) and localisation state at each change
    started_anywhere   True if the first of them is LOST, as the drive may start anywhere in the map
    merged_walls       walls that were merged with another one
    loops              every loop decision with its scores, see `loop_row`
    overlap_ratios     of all tracked scans; NaN for those without walls
    keyframe_times     milliseconds of each keyframe
    stage_times        milliseconds of all keyframes, by stage
    """

    slipped_scans: int = 0
    failed_scans: int = 0
    featureless_scans: int = 0
    lost_scans: int = 0
    states: list[tuple[float, LocalisationState]] = field(default_factory=list)
    started_anywhere: bool = False
    merged_walls: int = 0
    loops: list[dict[str, object]] = field(default_factory=list)
    overlap_ratios: array[float] = field(default_factory=lambda: array("d"))  # of days: a list is four times as large
    keyframe_times: list[float] = field(default_factory=list)
    stage_times: dict[str, float] = field(default_factory=dict)

    def add_tracking(self, scan: ProcessedScan, tracking: TrackingResult) -> None:
        """Count a scan by its tracking status."""
        shows_walls = scan.features.segments.total_length >= MIN_WALL_LENGTH
        self.overlap_ratios.append(tracking.registration.overlap_ratio if shows_walls else math.nan)
        self.slipped_scans += tracking.slipped
        self.failed_scans += tracking.status is TrackingStatus.FAILED
        self.featureless_scans += tracking.status is TrackingStatus.NO_FEATURES

    def add_keyframe(self, update: KeyframeUpdate, timer: StageTimer) -> None:
        """Count a keyframe, its changes of the map and its times."""
        self.keyframe_times.append(timer.total)
        for stage, duration in timer.laps.items():
            self.stage_times[stage] = self.stage_times.get(stage, 0.0) + duration
        self.merged_walls += update.merge is not None
        if update.loop is not None:
            self.add_loop(update.scan.stamp, update.loop)

    def add_loop(self, stamp: float, decision: LoopDecision) -> None:
        """Add the row of a loop decision; the compared points are not kept."""
        self.loops.append(loop_row(stamp, decision))

    def state_rows(self) -> list[dict[str, object]]:
        """Return the changes of the localisation state."""
        return [
            {"stamp": stamp, "state": state.status.value, "direction": state.direction} for stamp, state in self.states
        ]

    def lost_spans(self, end: float) -> list[tuple[float, float]]:
        """Return from when to when the robot was LOST, as stamps; `end` is that of the end of the run."""
        stamps = [stamp for stamp, _ in self.states] + [end]
        lost = [state.status is LocalisationStatus.LOST for _, state in self.states]
        return [(stamps[k], stamps[k + 1]) for k, is_lost in enumerate(lost) if is_lost]

    def timings(self) -> dict[str, float]:
        """Return milliseconds per keyframe: median, 99th percentile, maximum, and the mean of each stage."""
        if not self.keyframe_times:
            return {}
        times = np.array(self.keyframe_times)
        result = {
            "keyframe_median_ms": float(np.median(times)),
            "keyframe_p99_ms": float(np.percentile(times, 99)),
            "keyframe_max_ms": float(times.max()),
        }
        for stage, total in self.stage_times.items():
            result[f"{stage.replace(' ', '_')}_mean_ms"] = total / len(times)
        return {name: round(value, 3) for name, value in result.items()}

    def health(self) -> dict[str, object]:
        """Return how well the scans fitted the map, and how many were not tracked normally.

        The overlap ratios are None if most scans show no walls, as among trees: the others say little then.
        """
        ratios = np.array(self.overlap_ratios)
        known = ratios[np.isfinite(ratios)]
        enough = 2 * len(known) > len(ratios)
        median, low = np.percentile(known, (50, 5)).round(3).tolist() if enough else (None, None)
        return {
            "overlap_ratio_median": median,
            "overlap_ratio_p05": low,
            "slipped": self.slipped_scans,
            "failed": self.failed_scans,
            "no_features": self.featureless_scans,
            "lost": self.lost_scans,
        }


def loop_counts(rows: Sequence[Mapping[str, object]]) -> dict[str, int]:
    """Return the number of loop decisions, in total and by status."""
    decided = [row["status"] for row in rows]
    return {"proposed": len(decided), **{status.value: decided.count(status) for status in DECIDED}}


def part_rows(state: SlamState) -> list[dict[str, object]]:
    """Return where each part of the map begins, and whether it is joined with the first; empty if there is only one.

    If it is not joined, `sigma` are the standard deviations (metres, metres, radians) of its pose relative to the
    keyframe before it, by odometry; large ones if odometry did not measure the motion.
    """
    parts, stamps, mapper = state.mapper.landmarks.parts, state.keyframe_stamps, state.mapper
    if len(parts) == 1:
        return []
    return [
        {"keyframe": first, "stamp": stamps[first], "joined": group == 0, "odometry": measured}
        | ({"sigma": _step_sigmas(mapper, first)} if group else {})
        for first, group, measured in zip(parts.firsts, parts.groups, parts.measured, strict=True)
        if first < len(stamps)
    ]


def _step_sigmas(mapper: Mapper, keyframe: int) -> list[float]:
    """Return the standard deviations (metres, metres, radians) of a keyframe's pose relative to the one before."""
    return [round(float(sigma), 4) for sigma in np.sqrt(np.diag(mapper.covariances.relative(keyframe - 1, keyframe)))]


def loop_row(stamp: float, decision: LoopDecision) -> dict[str, object]:
    """Return a loop decision and its scores as plain data."""
    scores = {
        "overlap_ratio": decision.fit,
        "runner_up": decision.runner_up,
        "sigma": decision.sigma,
        "contradicted": decision.contradicted,
        "margin": decision.margin,
        "shift": decision.shift,
    }
    return {
        "candidate": decision.candidate,
        "stamp": stamp,
        "keyframe": decision.keyframe,
        "old": decision.old,
        "status": decision.status,
        "reason": decision.reason,
        "matches": len(decision.matches),
        "merged": len(decision.merged),
        "motion": decision.motion.round(4).tolist(),
        **{name: round(value, 4) for name, value in scores.items()},
    }


def run_summary(
    preprocessor: Preprocessor, state: SlamState, statistics: RunStatistics, end: float
) -> dict[str, object]:
    """Return the summary of a run that ended at the stamp `end` as plain data."""
    mapper, parts, lost = state.mapper, part_rows(state), statistics.lost_spans(end)
    second = {"scans": preprocessor.second_scans, "joined": preprocessor.joined_scans}
    return {
        "scans": preprocessor.scans,
        **({"second_lidar": second} if second["scans"] else {}),
        "keyframes": mapper.keyframe_count,
        "factors": mapper.graph.factor_count,
        "merged_walls": statistics.merged_walls,
        "removed_walls": len(mapper.landmarks.removed_walls()),
        "loops": loop_counts(statistics.loops),
        "loop_decisions": statistics.loops,
        "returns": summarise(state.loops.returns),
        "states": statistics.state_rows(),
        **({"start_recognised": True} if statistics.started_anywhere and len(statistics.states) > 1 else {}),
        **({"lost": lost} if lost else {}),
        **({"parts": parts} if parts else {}),
        "odometry": _odometry_errors(state.odometry_model),
        "sigma_range": round(preprocessor.noise.sigma_range, 5),
        "sigma_bearing": round(preprocessor.noise.sigma_bearing, 6),
        "range_bias": _range_bias(mapper.graph.range_bias),
        "wall_roughness": round(math.sqrt(mapper.roughness.variances.offset), 5),
        "timings": statistics.timings(),
        "health": statistics.health()
        | {
            "empty_scans": preprocessor.empty_scans,
            "scans_without_odometry": preprocessor.scans_without_odometry,
        },
    }


def _odometry_errors(model: OdometryModel) -> dict[str, Any]:
    """Return the estimated errors of odometry: systematic ones, if wheels have measured it, and random ones."""
    names = ("length", "turning", "veer", "x", "y", "heading")
    values, sigmas = model.systematic_errors.values, np.sqrt(model.systematic_errors.variances)
    systematic = {
        name: {"value": round(value, 5), "sigma": round(sigma, 5)}
        for name, value, sigma in zip(names, values.tolist(), sigmas.tolist(), strict=True)
    }
    along, across, heading, turning = model.deviations.round(5).tolist()
    random = {"along": along, "across": across, "heading_per_metre": heading, "heading_per_radian": turning}
    return {**({"systematic": systematic} if model.measured else {}), "random": random}


def _range_bias(bias: RangeBias) -> dict[str, float | None]:
    """Return the estimate of the range bias and its standard deviation, metres; None if it was not estimated."""
    sigma = None if math.isnan(bias.sigma) else round(bias.sigma, 5)
    return {"metres": round(bias.metres, 5), "sigma": sigma}
