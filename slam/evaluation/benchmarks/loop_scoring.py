"""Score loop decisions, relocalisations and the final map of a simulated run against ground truth."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from drivers import se2
from drivers.simulation import Simulation

from ...events import (
    Event,
    Finished,
    KeyframeAdded,
    LoopDecided,
    MapUpdated,
    Relocalised,
    WallsMerged,
)
from ...geometry.segments import Floats
from ...loop_closure.loop_status import LoopStatus
from ...mapping.map_features import MapWalls
from ..ground_truth import match_walls, true_walls
from ..metrics import align, motion_errors

SAME_PLACE_DISTANCE = 1.0  # metres between two true poses at one place
MIN_REVISIT_DISTANCE = 20.0  # metres travelled between two visits of one place
MIN_SHARED_LENGTH = 0.5  # metres of one true wall that two mapped walls must both cover to count as doubled
MIN_OBSERVATIONS = 3  # of a true wall by a mapped one


@dataclass(frozen=True, slots=True)
class ScoredDecision:
    """A loop decision, and the error of the relative pose of its two keyframes (metres, radians).

    For a closed loop it is that of the decision or of the final map, whichever is larger: the map may be bent although
    the decision was right.
    """

    keyframe: int
    status: str
    reason: str
    error: float
    angle_error: float


@dataclass(frozen=True, slots=True)
class Revisit:
    """A keyframe at the place of an `earlier` one, and its error relative to that when it was added, metres."""

    keyframe: int
    earlier: int
    error: float


class LoopScorer:
    """A sink for one run of a simulation.

    decisions              all loop decisions
    revisits               all keyframes at places visited before
    relocalisation_errors  metres, of each relocalisation relative to the nearest keyframe from before the loss
    """

    handled = (KeyframeAdded, MapUpdated, WallsMerged, LoopDecided, Relocalised)

    def __init__(self, simulation: Simulation) -> None:
        self._trajectory, self._walls = simulation.trajectory, true_walls(simulation.world, np.zeros(3))
        # By keyframe index, of those published; not of those that were processed again.
        self._estimate: dict[int, se2.Pose] = {}
        self._truth: dict[int, se2.Pose] = {}
        self._travelled: dict[int, float] = {}
        self._merged_into: dict[int, int] = {}
        self._observations: dict[int, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
        self._closed: dict[int, tuple[int, int]] = {}  # by candidate: index of the decision, and old keyframe
        self.decisions: list[ScoredDecision] = []
        self.revisits: list[Revisit] = []
        self.relocalisation_errors: list[float] = []

    def handle(self, event: Event) -> None:
        """Process one event."""
        match event:
            case KeyframeAdded():
                self._add_keyframe(event)
            case MapUpdated():
                self._estimate = dict(enumerate(event.keyframe_poses))
            case WallsMerged():
                self._merged_into[event.absorbed] = event.kept
            case LoopDecided():
                self._score_decision(event)
            case Relocalised():
                self._score_relocalisation(event)

    def _add_keyframe(self, event: KeyframeAdded) -> None:
        truth = self._trajectory.poses_at(np.array([event.stamp]))[0]
        before = max(self._truth, default=None)
        step = 0.0 if before is None else float(np.hypot(*(truth - self._truth[before])[:2]))
        travelled = step if before is None else self._travelled[before] + step
        self._estimate[event.index], self._truth[event.index] = event.pose, truth
        self._travelled[event.index] = travelled
        indices = np.array(list(self._truth))
        distance = np.hypot(*(np.array(list(self._truth.values()))[:, :2] - truth[:2]).T)
        distance[np.array(list(self._travelled.values())) > travelled - MIN_REVISIT_DISTANCE] = np.inf
        if distance.min() < SAME_PLACE_DISTANCE:
            earlier = int(indices[distance.argmin()])
            self.revisits.append(Revisit(event.index, earlier, self._motion_error(earlier, event.index, event.pose)[0]))
        self._record_observations(event, truth)

    def _motion_error(self, old: int, keyframe: int, pose: se2.Pose) -> tuple[float, float]:
        """Return the error (metres, radians) of the motion from keyframe `old` to another keyframe at `pose`."""
        old = max(index for index in self._truth if index <= old)
        estimated = se2.between(self._estimate[old], pose)
        true = se2.between(self._truth[old], self._truth[keyframe])
        errors = motion_errors(estimated[None], true[None])
        return float(errors.translation[0]), float(errors.rotation[0])

    def _score_decision(self, event: LoopDecided) -> None:
        for old, recent in event.merged:
            self._merged_into[recent] = old
        before = self._estimate if event.correction is None else event.correction.keyframe_poses_before
        there = se2.compose(before[event.index], event.motion)
        error, angle_error = self._motion_error(event.old, event.index, there)
        if event.status is LoopStatus.ACCEPTED:
            self._closed[event.candidate] = len(self.decisions), event.old
        elif event.status is LoopStatus.RETRACTED:
            del self._closed[event.candidate]
        self.decisions.append(ScoredDecision(event.index, event.status, event.reason, error, angle_error))

    def _score_relocalisation(self, event: Relocalised) -> None:
        indices = [index for index in self._truth if index < event.first]
        offsets = np.array([self._estimate[index] for index in indices])[:, :2] - event.pose[:2]
        nearest = indices[int(np.hypot(*offsets.T).argmin())]
        estimated = se2.between(self._estimate[nearest], event.pose)
        true = se2.between(self._truth[nearest], self._trajectory.poses_at(np.array([event.stamp]))[0])
        self.relocalisation_errors.append(float(motion_errors(estimated[None], true[None]).translation[0]))

    @property
    def drift(self) -> float:
        """Largest error of a keyframe at a revisited place, relative to the earlier visit, metres."""
        return max((revisit.error for revisit in self.revisits), default=0.0)

    # --- Scores of the final map

    def score_closed(self, keyframes: Floats) -> None:
        """Give the closed loops the errors of the final map, with keyframes (k, 3), if they are larger."""
        self._estimate = dict(enumerate(keyframes))
        for index, old in self._closed.values():
            decision = self.decisions[index]
            error, angle_error = self._motion_error(old, decision.keyframe, keyframes[decision.keyframe])
            error, angle_error = max(error, decision.error), max(angle_error, decision.angle_error)
            self.decisions[index] = replace(decision, error=error, angle_error=angle_error)

    def joined_share(self, finished: Finished, tolerance: float) -> float:
        """Return the share of revisits whose relative error in the final map is below `tolerance` metres."""
        self._estimate = dict(enumerate(finished.keyframes.poses))
        errors = [self._motion_error(v.earlier, v.keyframe, self._estimate[v.keyframe])[0] for v in self.revisits]
        return float(np.mean(np.array(errors) < tolerance)) if errors else 1.0

    def last_error(self, finished: Finished) -> float:
        """Return the position error of the last keyframe relative to the first, metres."""
        truth = self._trajectory.poses_at(finished.keyframes.stamps[[0, -1]])
        ends = np.array([se2.between(poses[0], poses[-1]) for poses in (finished.keyframes.poses, truth)])
        return float(motion_errors(ends[:1], ends[1:]).translation[0])

    def ate(self, finished: Finished) -> float:
        """Return the RMS position error of the keyframes after alignment with ground truth, metres."""
        estimate, truth = finished.keyframes.poses[:, :2], self._trajectory.poses_at(finished.keyframes.stamps)[:, :2]
        error = se2.transform(align(estimate, onto=truth), estimate) - truth
        return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))

    def _record_observations(self, event: KeyframeAdded, truth: se2.Pose) -> None:
        """Record which parts of true walls a keyframe's segments observe."""
        half, no_covariance = event.segments.half_length, np.zeros((len(event.segments), 2, 2))
        frames = se2.compose(truth, event.segments.frame).reshape(-1, 3)
        pieces = tuple(np.column_stack([-half, half])[:, None])
        observed = MapWalls(
            event.wall_match, frames, -half, half, np.ones(len(half), dtype=np.int64), no_covariance, pieces
        )
        ends = observed.end_points()
        for row, true in enumerate(match_walls(observed, self._walls)):
            if true >= 0 and event.wall_match[row] >= 0:
                low, high = sorted(se2.transform(se2.inverse(self._walls.frame[true]), ends[row])[:, 0].tolist())
                self._observations[int(event.wall_match[row])][int(true)].append((low, high))

    def doubled_walls(self, final: MapWalls) -> int:
        """Return the number of walls of the final map that cover a part of a true wall covered by another one."""
        spans_by_wall: dict[int, dict[int, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
        mapped = set(final.identity.tolist())
        for identity, by_true in self._observations.items():
            while identity in self._merged_into:
                identity = self._merged_into[identity]
            for true, spans in by_true.items():
                spans_by_wall[true][identity] += spans
        return sum(
            _overlaps([_hull(spans) for wall, spans in walls.items() if wall in mapped])
            for walls in spans_by_wall.values()
        )


def _hull(spans: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the extent along a true wall that a mapped one covers; empty with too few observations."""
    if len(spans) < MIN_OBSERVATIONS:
        return 0.0, 0.0
    return min(low for low, _ in spans), max(high for _, high in spans)


def _overlaps(spans: list[tuple[float, float]]) -> int:
    """Return the number of spans that overlap an earlier one."""
    count, reached = 0, -np.inf
    for low, high in sorted(spans):
        count += min(high, reached) - low > MIN_SHARED_LENGTH
        reached = max(reached, high)
    return count
