"""Telling the listeners what happened: events made of copies, and none made where nobody listens."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drivers import se2

from .estimation.map_view import covariances_when_last_seen, map_features
from .estimation.slam_state import KeyframeUpdate
from .events import (
    ComparedWalls,
    Correction,
    Event,
    GraphInspected,
    KeyframeAdded,
    LoopDecided,
    LoopTest,
    MapUpdated,
    Sink,
    WallsMerged,
    WallsRemoved,
)
from .loop_closure.closer import LoopDecision
from .mapping.mapper import Mapper
from .preprocessing.preprocessor import ProcessedScan

MAP_INTERVAL = 20  # keyframes between two events with the whole map
MAP_SHARE = 0.01  # of the keyframes: for long runs the interval grows, lest telling them take longer than making them
INSPECTION_GROWTH = 1.5  # times as many keyframes as at the last inspection: in all, three times the last one's cost


class Publisher:
    """Sends events to sinks."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._sinks = tuple(sinks)
        self._published_keyframes = np.zeros((0, 3))
        self._published_removed: frozenset[int] | None = None  # walls; what a session knows already is no news
        self._inspected = 0  # keyframes at the last inspection

    def publish(self, event: Event) -> None:
        """Send an event that is cheap to make."""
        for sink in self._sinks:
            sink.handle(event)

    def publish_keyframe(
        self,
        scan: ProcessedScan,
        mapper: Mapper,
        extension: KeyframeUpdate,
        sigma_range: float,
        timings: dict[str, float],
    ) -> None:
        """Tell of the last keyframe, of what it changed, and of the whole map every so often."""
        if not self._sinks:
            return
        index, stamp = mapper.keyframe_count - 1, scan.stamp
        self.publish(_keyframe_event(scan, mapper, extension, sigma_range, timings))
        if extension.merge is not None:
            merge = extension.merge
            self.publish(WallsMerged(index, stamp, merge.kept, merge.absorbed, merge.distance))
        if extension.loop is not None:
            self.publish(_loop_event(extension.loop, stamp, mapper, extension.superseded))
        if extension.superseded is not None:
            self.publish_map(stamp, mapper)
            self.publish_residuals(stamp, mapper)
        elif index == 0 or index >= len(self._published_keyframes) - 1 + max(MAP_INTERVAL, MAP_SHARE * index):
            self.publish_map(stamp, mapper)
            if index >= INSPECTION_GROWTH * self._inspected:
                self.publish_residuals(stamp, mapper)

    def publish_loop(self, decision: LoopDecision, stamp: float, mapper: Mapper, superseded: Mapper) -> None:
        """Tell of a closure that was taken back, and of the map as it is without it."""
        if not self._sinks:
            return
        self.publish(_loop_event(decision, stamp, mapper, superseded))
        self.publish_map(stamp, mapper)
        self.publish_residuals(stamp, mapper)

    def publish_keyframes(self, mapper: Mapper, scans: Mapping[int, ProcessedScan], sigma_range: float) -> None:
        """Tell of all keyframes where they are on a map that is finished; `sightings` are theirs."""
        if not self._sinks:
            return
        for index, scan in scans.items():
            landmark_ids = mapper.landmark_ids[index]
            self.publish(
                KeyframeAdded(
                    index=index,
                    stamp=scan.stamp,
                    pose=mapper.keyframe_poses[index],
                    pose_covariance=mapper.keyframe_covariance(index),
                    odometry=scan.odometry,
                    points=scan.features.points.all,
                    segments=scan.features.segments,
                    corners=scan.features.corners,
                    line_match=landmark_ids.walls,
                    line_gate=np.full(len(landmark_ids.walls), np.nan),
                    line_nearest=np.full_like(landmark_ids.walls, -1),
                    corner_match=landmark_ids.corners,
                    corner_gate=np.full(len(landmark_ids.corners), np.nan),
                    corner_nearest=np.full_like(landmark_ids.corners, -1),
                    new_lines=np.zeros(0, dtype=np.int64),
                    sigma_range=sigma_range,
                    timings={},
                    counts=_sizes(mapper),
                )
            )

    def publish_map(self, stamp: float, mapper: Mapper, index: int | None = None) -> None:
        """Tell of the whole map, as it is after the last keyframe, or after the one of `index`."""
        if not self._sinks:
            return
        keyframes = mapper.graph.keyframe_poses(mapper.keyframe_count)
        common = min(len(keyframes), len(self._published_keyframes))
        moved = keyframes[:common, :2] - self._published_keyframes[:common, :2]
        self._published_keyframes = keyframes
        self._publish_removed(len(keyframes) - 1 if index is None else index, stamp, mapper)
        lines, corners = map_features(mapper, covariances=False)
        of_lines, of_corners = covariances_when_last_seen(mapper, lines, corners)
        self.publish(
            MapUpdated(
                index=len(keyframes) - 1 if index is None else index,
                stamp=stamp,
                keyframes=keyframes,
                lines=replace(lines, covariance=of_lines),
                corners=replace(corners, covariance=of_corners),
                chi2=mapper.graph.chi2(),
                shift=float(np.max(np.hypot(moved[:, 0], moved[:, 1]), initial=0.0)),
            )
        )

    def _publish_removed(self, index: int, stamp: float, mapper: Mapper) -> None:
        """Tell of the walls that are no longer there since the map was told last."""
        removed = frozenset(mapper.landmarks.removed_walls().tolist())
        news = removed - self._published_removed if self._published_removed is not None else frozenset()
        self._published_removed = removed
        if news:
            self.publish(WallsRemoved(index, stamp, tuple(sorted(news))))

    def publish_residuals(self, stamp: float, mapper: Mapper) -> None:
        """Tell how well every factor fits."""
        if self._sinks:
            self._inspected = mapper.keyframe_count
            self.publish(GraphInspected(mapper.keyframe_count - 1, stamp, mapper.graph.residuals()))


def _sizes(mapper: Mapper) -> dict[str, int]:
    """Of the map and the graph."""
    landmarks = mapper.landmarks
    return {"walls": len(landmarks.walls), "corners": len(landmarks.corners), "factors": mapper.graph.factor_count}


def _keyframe_event(
    scan: ProcessedScan, mapper: Mapper, extension: KeyframeUpdate, sigma_range: float, timings: dict[str, float]
) -> KeyframeAdded:
    view = extension.view
    return KeyframeAdded(
        index=mapper.keyframe_count - 1,
        stamp=scan.stamp,
        pose=mapper.pose,
        pose_covariance=mapper.last_pose_covariance(),
        odometry=scan.odometry,
        points=scan.features.points.all,
        segments=view.segments,
        corners=view.corners,
        line_match=view.walls,
        line_gate=view.wall_distance,
        line_nearest=view.nearest_wall,
        corner_match=view.corner_landmarks,
        corner_gate=view.corner_distance,
        corner_nearest=view.nearest_corner,
        new_lines=view.new_walls,
        sigma_range=sigma_range,
        timings=timings,
        counts=_sizes(mapper),
    )


def _loop_event(decision: LoopDecision, stamp: float, mapper: Mapper, superseded: Mapper | None) -> LoopDecided:
    verdict = decision.verdict
    return LoopDecided(
        index=decision.keyframe,
        stamp=stamp,
        candidate=decision.candidate,
        old=decision.old,
        motion=decision.motion,
        status=decision.status,
        reason=verdict.reason,
        overlap_ratio=verdict.overlap_ratio,
        matches=verdict.matches,
        runner_up=verdict.runner_up,
        sigma=verdict.sigma,
        contradicted=verdict.contradicted,
        merged=decision.merged,
        shift=decision.shift,
        tests=tuple(LoopTest(t.name, float(t.value), t.gate, t.at_least, t.passed) for t in verdict.tests),
        sight=_sight(decision),
        correction=None if superseded is None else _correction(decision, mapper, superseded),
    )


def _sight(decision: LoopDecision) -> ComparedWalls | None:
    if decision.sight is None:
        return None
    recent, old = (constellation.end_points() for constellation in decision.sight)
    aligned = se2.transform(decision.hypothesis.motion, recent)
    return ComparedWalls(recent, aligned, old, decision.hypothesis.matches.copy())


def _correction(decision: LoopDecision, mapper: Mapper, superseded: Mapper) -> Correction:
    """What became of the keyframes up to the decision's: a closure that is taken back makes the later ones anew."""
    count = decision.keyframe + 1
    closed = decision.status == "accepted"
    return Correction(
        keyframes_before=superseded.graph.keyframe_poses(count),
        keyframes=mapper.graph.keyframe_poses(count),
        lines_before=map_features(superseded, covariances=False)[0],
        chi2_before=superseded.graph.chi2(),
        chi2_strained=mapper.graph.chi2_at(superseded.graph) if closed else math.nan,
        chi2=mapper.graph.chi2(),
    )
