"""Publish what happens as events with copied data. Those that take time are only built if a sink receives them."""

from __future__ import annotations

import bisect
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.gaps import unseen_stretches

from ..checks import Suspect
from ..estimation.map_view import covariances_when_last_seen, map_features
from ..estimation.scan_update import KeyframeUpdate
from ..estimation.stage_timer import StageTimer
from ..events import (
    Event,
    GraphInspected,
    KeyframeAdded,
    LoopDecided,
    MapUpdated,
    Notice,
    ScanTracked,
    Sink,
    StateChanged,
    SuspectFound,
    WallsMerged,
    WallsRemoved,
)
from ..geometry.segments import Floats
from ..localisation.state import LocalisationState
from ..localisation.tracking import TrackingResult, TrackingStatus
from ..loop_closure.decision import LoopDecision
from ..mapping.mapper import Mapper
from ..odometry.error_model import OdometryModel
from ..odometry.velocity import VelocityFilter
from ..preprocessing.preprocessor import ProcessedScan
from .event_contents import keyframe_event, loop_event, settled_keyframe_event
from .odometry_deviations import OdometryDeviations
from .stretches import Stretches

# Keyframes between two events with the whole map.
MAP_INTERVAL = 20
# Share of all keyframes that this interval is at least, so that long runs do not spend most of their time on events.
MAP_INTERVAL_SHARE = 0.01
# Factor by which the number of keyframes grows between two inspections of the graph: all inspections together cost
# three times the last one.
INSPECTION_GROWTH = 1.5


class Publisher:
    """Sends events to sinks."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._sinks: list[tuple[Sink, tuple[type, ...]]] = [(s, getattr(s, "handled", (object,))) for s in sinks]
        self._published_keyframes = np.zeros((0, 3))
        self._published_removed: frozenset[int] | None = None  # wall ids; None before the first map of a session
        self._inspected_keyframes = 0  # at the last inspection of the graph
        self._last_tracked: tuple[se2.Pose, se2.Pose] | None = None  # pose of a scan and of odometry
        self._deviations = OdometryDeviations()
        # As in a gap in the scans, it is not seen what the robot does meanwhile: it may be carried.
        reason = "the lidar was covered, or everything was out of its range"
        self._blind = Stretches("the scans showed nothing", reason)
        consequence = "the motion was predicted from the scans"
        self._unmeasured = Stretches("odometry was missing or contradicted the scans", consequence)

    def publish(self, event: Event) -> None:
        """Send an event to the sinks that receive its type."""
        for sink, handled in self._sinks:
            if isinstance(event, handled):
                sink.handle(event)

    def _is_received(self, *types: type[Event]) -> bool:
        """Return True if a sink receives events of one of these types."""
        return any(issubclass(one, handled) for one in types for _, handled in self._sinks)

    def publish_tracking(
        self,
        scan: ProcessedScan,
        tracking: TrackingResult,
        mapper: Mapper,
        odometry_model: OdometryModel,
        velocity: VelocityFilter | None = None,
    ) -> None:
        """Publish the pose of a scan, and a notice if it was not tracked normally.

        velocity  of the base at the scan while odometry is failing, else None
        """
        self._blind.add(scan.stamp, wrong=tracking.status is TrackingStatus.NO_FEATURES)
        self._unmeasured.add(scan.stamp, wrong=not scan.measured)
        if tracking.slipped:
            self._publish_slip(scan, tracking)
        if tracking.status is TrackingStatus.TRACKED:
            self._last_tracked = tracking.pose, scan.odometry
        if tracking.status is TrackingStatus.FAILED:
            self.publish(Notice(scan.stamp, "the scan fits nowhere near its predicted pose and is left out"))
        if not self._is_received(ScanTracked):
            return
        overlap_ratio, keyframe = tracking.registration.overlap_ratio, mapper.keyframe_count - 1
        self.publish(
            ScanTracked(
                scan.stamp,
                tracking.pose,
                scan.odometry,
                overlap_ratio,
                keyframe,
                points=scan.features.points.xy,
                covariance=tracking.covariance,
                odometry_model=copy(odometry_model),  # its arrays are replaced, not changed
                velocity=velocity,
            )
        )

    def _publish_slip(self, scan: ProcessedScan, tracking: TrackingResult) -> None:
        """Publish that odometry contradicts the scan.

        Before the first tracked scan of a continued session nothing is published: the wheels count from where they were
        switched on, so nothing is known of the motion since the session was stored.
        """
        if self._last_tracked is None:
            return
        pose, odometry = self._last_tracked
        deviation = se2.between(se2.between(pose, tracking.pose), se2.between(odometry, scan.odometry))
        self.publish(self._deviations.add(scan.stamp, deviation))

    def publish_deviations(self, scans: int) -> None:
        """Publish at the end of a run of a number of `scans` how often odometry was far off from them, if ever."""
        if (notice := self._deviations.summary(scans)) is not None:
            self.publish(notice)

    def publish_stretches(self) -> None:
        """Publish at the end of a run how long and when scans showed nothing, or odometry was not used, if ever."""
        for stretches in (self._blind, self._unmeasured):
            if (notice := stretches.summary()) is not None:
                self.publish(notice)

    def publish_unseen(self, scans: Floats, stamps: Floats, poses: Floats) -> None:
        """Publish at the end of a run where the path begins before the first scan, or goes on after the last one.

        scans   (m,) stamps of the scans, seconds
        stamps  (n,) of the path
        poses   (n, 3) of the path
        """
        for one in unseen_stretches(scans, stamps, poses[:, :2]):
            where = "before the first scan" if one.start < scans[0] else "after the last scan"
            text = f"{one.duration:.1f} s {where} the robot drives {one.length:.1f} m: the path is by odometry alone"
            self.publish(Notice(one.start, text))

    def publish_suspects(self, suspects: Sequence[Suspect], keyframe_stamps: Sequence[float], start: float) -> None:
        """Publish the findings of the checks of a finished run, with times since the stamp `start` (seconds)."""
        for suspect in suspects:
            index = max(bisect.bisect_right(keyframe_stamps, suspect.stamp) - 1, 0)
            self.publish(SuspectFound(index, suspect.stamp, suspect.sentence(start), suspect.position.copy()))

    def publish_state(self, stamp: float, state: LocalisationState) -> None:
        """Publish a new localisation state."""
        self.publish(StateChanged(stamp, state.status.value, state.direction))

    def publish_keyframe(self, mapper: Mapper, update: KeyframeUpdate, sigma_range: float, timer: StageTimer) -> None:
        """Publish the last keyframe, its changes of the map, and at intervals the whole map."""
        index, stamp = mapper.keyframe_count - 1, update.scan.stamp
        if self._is_received(KeyframeAdded):
            self.publish(keyframe_event(mapper, update, sigma_range, dict(timer.laps)))
        if update.merge is not None:
            merge = update.merge
            self.publish(WallsMerged(index, stamp, merge.kept, merge.absorbed, merge.distance))
        if update.loop is not None and self._is_received(LoopDecided):
            self.publish(loop_event(update.loop, stamp, mapper, update.superseded))
        if update.superseded is not None:
            self.publish_map(stamp, mapper)
            self.publish_residuals(stamp, mapper)
        elif index == 0 or index >= len(self._published_keyframes) - 1 + max(MAP_INTERVAL, MAP_INTERVAL_SHARE * index):
            self.publish_map(stamp, mapper)
            if index >= INSPECTION_GROWTH * self._inspected_keyframes:
                self.publish_residuals(stamp, mapper)

    def publish_loop(self, decision: LoopDecision, stamp: float, mapper: Mapper, superseded: Mapper) -> None:
        """Publish a retracted closure, or one at the end of a run, and the map; `superseded` is the one before."""
        if self._is_received(LoopDecided):
            self.publish(loop_event(decision, stamp, mapper, superseded))
        self.publish_map(stamp, mapper)
        self.publish_residuals(stamp, mapper)

    def publish_rejected_loop(self, decision: LoopDecision, stamp: float, mapper: Mapper) -> None:
        """Publish the decision against a hypothesis that was given up."""
        if self._is_received(LoopDecided):
            self.publish(loop_event(decision, stamp, mapper, None))

    def publish_keyframes(self, mapper: Mapper, scans: Mapping[int, ProcessedScan], sigma_range: float) -> None:
        """Publish all keyframes of a finished map; `scans` are theirs, by keyframe."""
        if not self._is_received(KeyframeAdded):
            return
        for index, scan in scans.items():
            self.publish(settled_keyframe_event(index, scan, mapper, sigma_range))

    def publish_map(self, stamp: float, mapper: Mapper, index: int | None = None) -> None:
        """Publish the whole map, as it is after the last keyframe or after the one of `index`."""
        if not self._is_received(MapUpdated, WallsRemoved):
            return
        keyframes = mapper.graph.keyframe_poses(mapper.keyframe_count)
        common = min(len(keyframes), len(self._published_keyframes))
        moved = keyframes[:common, :2] - self._published_keyframes[:common, :2]
        self._published_keyframes = keyframes
        self._publish_removed(len(keyframes) - 1 if index is None else index, stamp, mapper)
        walls, corners = map_features(mapper)
        of_walls, of_corners = covariances_when_last_seen(mapper, walls, corners)
        self.publish(
            MapUpdated(
                index=len(keyframes) - 1 if index is None else index,
                stamp=stamp,
                keyframe_poses=keyframes,
                walls=replace(walls, covariance=of_walls),
                corners=replace(corners, covariance=of_corners),
                chi2=mapper.graph.chi2(),
                dof=mapper.graph.degrees_of_freedom(),
                shift=float(np.max(np.hypot(moved[:, 0], moved[:, 1]), initial=0.0)),
            )
        )

    def _publish_removed(self, index: int, stamp: float, mapper: Mapper) -> None:
        """Publish the walls that were removed since the map was published last."""
        removed = frozenset(mapper.landmarks.removed_walls().tolist())
        news = removed - self._published_removed if self._published_removed is not None else frozenset()
        self._published_removed = removed
        if news:
            self.publish(WallsRemoved(index, stamp, tuple(sorted(news))))

    def publish_residuals(self, stamp: float, mapper: Mapper) -> None:
        """Publish the residual of every factor, and the walls removed since the map was published last."""
        if self._is_received(GraphInspected, WallsRemoved):
            self._publish_removed(mapper.keyframe_count - 1, stamp, mapper)
            self._inspected_keyframes = mapper.keyframe_count
            self.publish(GraphInspected(mapper.keyframe_count - 1, stamp, mapper.graph.residuals()))
