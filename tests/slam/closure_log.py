"""Review logs of given events, and a drive with a loop closure."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slam.events import (
    ComparedPoints,
    Correction,
    Event,
    GraphInspected,
    LoopCheck,
    LoopDecided,
    MapUpdated,
)
from slam.graph.residuals import ODOMETRY, WALL, Residuals
from slam.loop_closure.loop_status import LoopStatus
from slam.visualisation.rerun_log import ReviewLog

CLOSURE_KEYFRAME = 100  # keyframe


def with_closure(events: Sequence[Event]) -> list[Event]:
    """Return the events with a loop closure inserted at a keyframe, and an inspection of the graph."""
    extended: list[Event] = []
    for event in events:
        extended.append(event)
        if isinstance(event, MapUpdated) and event.index == CLOSURE_KEYFRAME:
            extended += [closure(event), inspection(event)]
    return extended


def closure(event: MapUpdated) -> LoopDecided:
    walls = event.walls.end_points()[:6]
    drifted = event.keyframe_poses + np.linspace(0, 1, len(event.keyframe_poses))[:, None] * [1.5, 1.0, 0.0]
    compared = ComparedPoints(walls[:, 0] + 1.0, walls[:, 0], event.walls.end_points()[:, 0])
    return LoopDecided(
        index=event.index, stamp=event.stamp, candidate=1, old=3, motion=np.array([-1.5, -1.0, 0.0]),
        status=LoopStatus.ACCEPTED, reason="all checks passed", overlap_ratio=0.9, matches=5, runner_up=0.2, sigma=0.01,
        contradicted=0.0, merged=((0, 40),), shift=1.8,
        checks=(LoopCheck("support", 5.0, 4.0, True, True),), compared=compared,
        correction=Correction(drifted, event.keyframe_poses, event.walls, 100.0, 5000.0, 120.0),
    )  # fmt: skip


def inspection(event: MapUpdated) -> GraphInspected:
    keyframes = np.arange(1, len(event.keyframe_poses))
    steps = np.column_stack([keyframes - 1, keyframes])
    seen = np.column_stack([keyframes, event.walls.identity[keyframes % len(event.walls)]])
    kinds = (ODOMETRY,) * len(steps) + (WALL,) * len(seen)
    squared = np.linspace(0.0, 60.0, len(kinds))
    residuals = Residuals(kinds, np.vstack([steps, seen]), squared, np.full(len(kinds), 2), np.ones(len(kinds)))
    return GraphInspected(event.index, event.stamp, residuals)


def write(path: Path, events: Sequence[Event]) -> Path:
    with ReviewLog(path) as review:
        for event in events:
            review.handle(event)
            while review.waiting > 50:
                time.sleep(0.001)
    assert review.failures == 0, review.first_failure
    return path
