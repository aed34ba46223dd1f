"""Report pages of a small session."""

import html
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slam.config import Config
from slam.events import Finished
from slam.io.run_results import RunResults, read_run_results, write_results
from slam.visualisation.report_page import write_page

DECISION = {
    "candidate": 5,
    "stamp": 16.0,
    "keyframe": 4,
    "old": 1,
    "status": "accepted",
    "reason": "all checks passed",
    "matches": 6,
    "merged": 3,
    "motion": [0.1, 0.0, 0.0],
    "overlap_ratio": 0.81,
    "runner_up": 0.4,
    "sigma": 0.02,
    "contradicted": 0.0,
    "shift": 0.13,
}
REJECTED = (("rejected", 7), ("rejected", 6))
SUMMARY: dict[str, Any] = {
    "recording": "room.mcap",
    "scans": 100,
    "duration": 20.0,
    "keyframes": 6,
    "walls": 4,
    "corners": 2,
    "path_length": 4.4,
    "slam_seconds": 1.0,
    "real_time_factor": 20.0,
    "peak_memory_mib": 300.0,
    "truth": {"ate_rmse": 0.0213, "ate_median": 0.02, "ate_max": 0.31, "heading_rmse": 0.42},
    "warnings": [],
    "skipped": {"messages": 0, "reasons": {}, "first": None},
    "slam": {
        "loops": {"proposed": 3, "accepted": 1, "rejected": 2, "retracted": 0},
        "loop_decisions": [
            DECISION,
            DECISION | {"candidate": 6, "status": "rejected", "reason": "<b>no</b>", "margin": 0.3},
            DECISION | {"candidate": 7, "status": "rejected", "reason": "3 looks agree", "margin": 0.75},
        ],
        "returns": {"count": 3, "looks": 20, "position_rms": 0.012, "position_max": 0.04},
        "timings": {"keyframe_median_ms": 1.5, "keyframe_p99_ms": 9.0, "keyframe_max_ms": 30.0, "graph_mean_ms": 0.7},
        "health": {"overlap_ratio_median": 0.95},
        "states": [],
    },
}


def make(folder: Path, finished: Finished, summary: dict[str, Any] = SUMMARY) -> RunResults:
    """Write and read a session whose path becomes ever less certain."""
    sigma = np.linspace(0.01, 0.15, len(finished.keyframes))
    covariance = np.eye(3) * np.square(sigma)[:, None, None]
    folder.mkdir(exist_ok=True)
    keyframes = replace(finished.keyframes, covariance=covariance)
    write_results(folder, replace(finished, keyframes=keyframes), Config(), summary)
    return read_run_results(folder)


def page(folder: Path, finished: Finished, summary: dict[str, Any] = SUMMARY) -> str:
    """Return the report page of a session, which is written to `folder`."""
    session = make(folder, finished, summary)
    write_page(folder / "report.html", session)
    return (folder / "report.html").read_text(encoding="utf-8")


def words(text: str) -> str:
    """Return the visible text, without markup and scripts."""
    text = re.sub(r"<(style|script|svg).*?</\1>", " ", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())
