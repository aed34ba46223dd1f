"""Telling the listeners what happened: events made of copies, and none made where nobody listens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .belief import Extension
from .events import Event, KeyframeAdded, LinesMerged, LoopDecided, MapUpdated, Sink
from .front_end import Sighting
from .loops.closer import LoopDecision
from .mapper import Mapper
from .snapshot import map_corners, map_lines

MAP_INTERVAL = 20  # keyframes between two events with the whole map


class Reporter:
    """Sends events to sinks."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._sinks = tuple(sinks)
        self._told_keyframes = np.zeros((0, 3))

    def tell(self, event: Event) -> None:
        """Send an event that is cheap to make."""
        for sink in self._sinks:
            sink.handle(event)

    def tell_keyframe(
        self,
        sighting: Sighting,
        mapper: Mapper,
        extension: Extension,
        sigma_range: float,
        timings: dict[str, float],
    ) -> None:
        """Tell of the last keyframe, of what it changed, and of the whole map every so often."""
        if not self._sinks:
            return
        view, index, stamp = extension.view, mapper.keyframe_count - 1, sighting.stamp
        self.tell(
            KeyframeAdded(
                index=index,
                stamp=stamp,
                pose=mapper.pose,
                pose_covariance=mapper.graph.keyframe_covariance(index),
                odometry=sighting.odometry,
                points=sighting.seen.points.all,
                segments=view.segments,
                corners=view.corners,
                line_match=view.walls,
                line_gate=view.wall_distance,
                corner_match=view.corner_landmarks,
                corner_gate=view.corner_distance,
                new_lines=view.new_walls,
                sigma_range=sigma_range,
                timings=timings,
                counts=_sizes(mapper),
            )
        )
        if extension.merge is not None:
            merge = extension.merge
            self.tell(LinesMerged(index, stamp, merge.kept, merge.absorbed, merge.distance))
        if extension.loop is not None:
            self.tell(_loop_event(extension.loop, stamp))
        if index % MAP_INTERVAL == 0 or (extension.loop is not None and extension.loop.merged):
            self.tell_map(stamp, mapper)

    def tell_loop(self, decision: LoopDecision, stamp: float, mapper: Mapper) -> None:
        """Tell of a closure that was taken back, and of the map as it is without it."""
        self.tell(_loop_event(decision, stamp))
        self.tell_map(stamp, mapper)

    def tell_keyframes(self, mapper: Mapper, sightings: Mapping[int, Sighting], sigma_range: float) -> None:
        """Tell of all keyframes where they are on a map that is finished; `sightings` are theirs."""
        if not self._sinks:
            return
        for index, sighting in sightings.items():
            names = mapper.names[index]
            self.tell(
                KeyframeAdded(
                    index=index,
                    stamp=sighting.stamp,
                    pose=mapper.trail[index],
                    pose_covariance=mapper.graph.keyframe_covariance(index),
                    odometry=sighting.odometry,
                    points=sighting.seen.points.all,
                    segments=sighting.seen.segments,
                    corners=sighting.seen.corners,
                    line_match=names.walls,
                    line_gate=np.full(len(names.walls), np.nan),
                    corner_match=names.corners,
                    corner_gate=np.full(len(names.corners), np.nan),
                    new_lines=np.zeros(0, dtype=np.int64),
                    sigma_range=sigma_range,
                    timings={},
                    counts=_sizes(mapper),
                )
            )

    def tell_map(self, stamp: float, mapper: Mapper, index: int | None = None) -> None:
        """Tell of the whole map, as it is after the last keyframe, or after the one of `index`."""
        if not self._sinks:
            return
        keyframes = mapper.graph.keyframe_poses(mapper.keyframe_count)
        common = min(len(keyframes), len(self._told_keyframes))
        moved = keyframes[:common, :2] - self._told_keyframes[:common, :2]
        self._told_keyframes = keyframes
        self.tell(
            MapUpdated(
                index=len(keyframes) - 1 if index is None else index,
                stamp=stamp,
                keyframes=keyframes,
                lines=map_lines(mapper, covariances=False),
                corners=map_corners(mapper, covariances=False),
                chi2=mapper.graph.chi2(),
                shift=float(np.max(np.hypot(moved[:, 0], moved[:, 1]), initial=0.0)),
            )
        )


def _sizes(mapper: Mapper) -> dict[str, int]:
    """Of the map and the graph."""
    landmarks = mapper.landmarks
    return {"walls": len(landmarks.walls), "corners": len(landmarks.corners), "factors": mapper.graph.factor_count}


def _loop_event(decision: LoopDecision, stamp: float) -> LoopDecided:
    verdict = decision.verdict
    return LoopDecided(
        index=decision.keyframe,
        stamp=stamp,
        candidate=decision.candidate,
        old=decision.old,
        motion=decision.motion,
        status=decision.status,
        reason=verdict.reason,
        explained=verdict.explained,
        matches=verdict.matches,
        runner_up=verdict.runner_up,
        sigma=verdict.sigma,
        contradicted=verdict.contradicted,
        merged=decision.merged,
        shift=decision.shift,
    )
