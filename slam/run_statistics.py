"""Counts and times of a run, for its summary."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from .localisation.state import State
from .loop_closure.closer import LoopDecision


class StageTimer:
    """Milliseconds by stage of one scan's work."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """The stage that has just ended took the time since the last one ended."""
        now = time.perf_counter()
        self.laps[stage] = 1e3 * (now - self._last)
        self._last = now

    @property
    def total(self) -> float:
        """Milliseconds of all stages."""
        return sum(self.laps.values())


@dataclass(slots=True)
class RunStatistics:
    """What a run counted. `health` and `timings` condense it."""

    searched: int = 0
    unplaced: int = 0
    blind: int = 0
    lost: int = 0
    states: list[tuple[float, State]] = field(default_factory=list)
    merged_walls: int = 0
    loops: list[dict[str, object]] = field(default_factory=list)
    """Every decision on a place that looked known, with the scores it was decided by."""
    overlap_ratio: list[float] = field(default_factory=list)
    keyframe_times: list[float] = field(default_factory=list)
    stage_times: dict[str, float] = field(default_factory=dict)

    def add_keyframe(self, timer: StageTimer) -> None:
        """Note the times of a scan that became a keyframe."""
        self.keyframe_times.append(timer.total)
        for stage, duration in timer.laps.items():
            self.stage_times[stage] = self.stage_times.get(stage, 0.0) + duration

    def loop_counts(self) -> dict[str, int]:
        """How many places looked known, and what became of them; "held" ones waited for a second look in vain."""
        decided = [row["status"] for row in self.loops]
        return {
            "proposed": len(decided),
            **{name: decided.count(name) for name in ("accepted", "held", "rejected", "retracted")},
        }

    def add_loop(self, stamp: float, decision: LoopDecision) -> None:
        """Note a decision; what it rested on, which is large, is not kept."""
        self.loops.append(loop_row(stamp, decision))

    def state_rows(self) -> list[dict[str, object]]:
        """When the state changed, and to what."""
        return [
            {"stamp": stamp, "state": state.condition.value, "direction": state.direction}
            for stamp, state in self.states
        ]

    def timings(self) -> dict[str, float]:
        """Milliseconds a keyframe: median, 99th percentile, maximum, and the mean of each stage."""
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
        """How well scans fitted the map, and what went wrong."""
        overlap_ratio = np.array(self.overlap_ratio or [0.0])
        return {
            "overlap_ratio_median": round(float(np.median(overlap_ratio)), 3),
            "overlap_ratio_p05": round(float(np.percentile(overlap_ratio, 5)), 3),
            "searched": self.searched,
            "unplaced": self.unplaced,
            "blind": self.blind,
            "lost": self.lost,
        }


def loop_row(stamp: float, decision: LoopDecision) -> dict[str, object]:
    """A decision on a place that looked known, with the scores it was decided by, as it is written down."""
    verdict = decision.verdict
    scores = {
        "overlap_ratio": verdict.overlap_ratio,
        "runner_up": verdict.runner_up,
        "sigma": verdict.sigma,
        "contradicted": verdict.contradicted,
        "shift": decision.shift,
    }
    return {
        "candidate": decision.candidate,
        "stamp": stamp,
        "keyframe": decision.keyframe,
        "old": decision.old,
        "status": decision.status,
        "reason": verdict.reason,
        "matches": verdict.matches,
        "merged": len(decision.merged),
        "motion": decision.motion.round(4).tolist(),
        **{name: round(value, 4) for name, value in scores.items()},
    }
