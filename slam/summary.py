"""What the pipeline counted and learned, for the summary of a run."""

from __future__ import annotations

import math

from .estimation.slam_state import SlamState
from .preprocessing.preprocessor import Preprocessor
from .run_statistics import RunStatistics


def run_summary(front_end: Preprocessor, slam_state: SlamState, statistics: RunStatistics) -> dict[str, object]:
    """As plain data."""
    return {
        "scans": front_end.scans,
        "keyframes": slam_state.mapper.keyframe_count,
        "factors": slam_state.mapper.graph.factor_count,
        "merged_walls": statistics.merged_walls,
        "retired_walls": len(slam_state.mapper.landmarks.removed_walls()),
        "loops": statistics.loop_counts(),
        "loop_decisions": statistics.loops,
        "states": statistics.state_rows(),
        "odometry_deviation_per_metre": slam_state.odometry_model.deviations.round(5).tolist(),
        "sigma_range": round(front_end.sigma_range, 5),
        "wall_unevenness": round(math.sqrt(slam_state.mapper.roughness.variance), 5),
        "timings": statistics.timings(),
        "health": statistics.health()
        | {
            "empty_scans": front_end.empty_scans,
            "scans_without_odometry": front_end.scans_without_odometry,
        },
    }
