"""Contents of the events about keyframes and loop decisions."""

from __future__ import annotations

import math

import numpy as np

from drivers import se2

from ..estimation.map_view import map_features
from ..estimation.scan_update import KeyframeUpdate
from ..events import ComparedPoints, Correction, KeyframeAdded, LoopCheck, LoopDecided
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..mapping.mapper import Mapper
from ..preprocessing.preprocessor import ProcessedScan


def keyframe_event(
    mapper: Mapper, update: KeyframeUpdate, sigma_range: float, timings: dict[str, float]
) -> KeyframeAdded:
    """Return the event of the last keyframe.

    sigma_range  standard deviation of a range, metres
    timings      milliseconds by stage of the scan's processing
    """
    scan, view = update.scan, update.observations
    return KeyframeAdded(
        index=mapper.keyframe_count - 1,
        stamp=scan.stamp,
        pose=mapper.pose,
        pose_covariance=mapper.covariances.of_last() + scan.features.sweep_covariance,
        odometry=scan.odometry,
        points=scan.features.points.xy,
        segments=view.segments,
        corners=view.corners,
        wall_match=view.association.walls,
        wall_gate=view.association.wall_distance,
        wall_nearest=view.association.nearest_wall,
        corner_match=view.association.corners,
        corner_gate=view.association.corner_distance,
        corner_nearest=view.association.nearest_corner,
        new_walls=view.new_walls,
        sigma_range=sigma_range,
        timings=timings,
        counts=_sizes(mapper),
    )


def settled_keyframe_event(index: int, scan: ProcessedScan, mapper: Mapper, sigma_range: float) -> KeyframeAdded:
    """Return the event of a keyframe of a finished map: without times, and without distances from landmarks.

    sigma_range  standard deviation of a range, metres
    """
    landmark_ids = mapper.landmark_ids[index]
    return KeyframeAdded(
        index=index,
        stamp=scan.stamp,
        pose=mapper.keyframe_poses[index],
        pose_covariance=mapper.covariances.of_keyframe(index) + scan.features.sweep_covariance,
        odometry=scan.odometry,
        points=scan.features.points.xy,
        segments=scan.features.segments,
        corners=scan.features.corners,
        wall_match=landmark_ids.walls,
        wall_gate=np.full(len(landmark_ids.walls), np.nan),
        wall_nearest=np.full_like(landmark_ids.walls, -1),
        corner_match=landmark_ids.corners,
        corner_gate=np.full(len(landmark_ids.corners), np.nan),
        corner_nearest=np.full_like(landmark_ids.corners, -1),
        new_walls=np.zeros(0, dtype=np.int64),
        sigma_range=sigma_range,
        timings={},
        counts=_sizes(mapper),
    )


def loop_event(decision: LoopDecision, stamp: float, mapper: Mapper, superseded: Mapper | None) -> LoopDecided:
    """Return the event of a loop decision; `superseded` is the map before, if the decision has changed it."""
    recent, old = decision.compared
    return LoopDecided(
        index=decision.keyframe,
        stamp=stamp,
        candidate=decision.candidate,
        old=decision.old,
        motion=decision.motion,
        status=decision.status,
        reason=decision.reason,
        overlap_ratio=decision.fit,
        matches=len(decision.matches),
        runner_up=decision.runner_up,
        sigma=decision.sigma,
        contradicted=decision.contradicted,
        merged=decision.merged,
        shift=decision.shift,
        margin=decision.margin,
        checks=tuple(LoopCheck(t.name, float(t.value), t.gate, t.at_least, t.passed) for t in decision.checks),
        compared=ComparedPoints(recent, se2.transform(decision.correction, recent), old),
        correction=None if superseded is None else _correction(decision, mapper, superseded),
    )


def _correction(decision: LoopDecision, mapper: Mapper, superseded: Mapper) -> Correction:
    """Return how the keyframes up to that of the decision moved: retracting a closure estimates later ones again."""
    count = decision.keyframe + 1
    closed = decision.status == LoopStatus.ACCEPTED
    return Correction(
        keyframe_poses_before=superseded.graph.keyframe_poses(count),
        keyframe_poses=mapper.graph.keyframe_poses(count),
        walls_before=map_features(superseded)[0],
        chi2_before=superseded.graph.chi2(),
        chi2_strained=mapper.graph.chi2_at(superseded.graph) if closed else math.nan,
        chi2=mapper.graph.chi2(),
    )


def _sizes(mapper: Mapper) -> dict[str, int]:
    """Return the numbers of walls and corners that are confirmed and neither merged nor removed, and of keyframes."""
    landmarks = mapper.landmarks
    walls = landmarks.walls.rows["in_graph"] & landmarks.active()
    confirmed = np.flatnonzero(landmarks.corners.rows["in_graph"])
    corners = landmarks.active_corners(confirmed)
    return {
        "walls": int(walls.sum()),
        "corners": int(corners.sum()),
        "keyframes": mapper.keyframe_count,
    }
